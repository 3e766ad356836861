/* A node: `fake_node WRITER TOPIC PERIOD_NS MESSAGES`; it lives until it is ended. With `time`, it says how much processor time a message takes (ns).
 * With another word, that is a topic: in each period it takes a message from there, and publishes only if it has got one;
 * the number of what it answers, where messages have one. With `timer` behind the topic, it publishes in a timer; with
 * `ticks`, it takes one message alone, and then publishes whenever a timer calls it, which with `elsewhere` another thread
 * has made, in the place of one that the node has removed; with
 * `pairs`, it takes two for each that it publishes; with `twice`, it publishes each two times.
 * FAKE_OTHERS in its environment is how many publishers of the topic it creates before, and removes after, its own.
 * FAKE_TOPICS is for how many further topics it creates publishers, TOPIC_0 and so on. With FAKE_SECOND, the full name of
 * another node in the process, that publishes on the topic as well, as WRITER + 1000. FAKE_NODES has the names of nodes that
 * it creates first, with the name `/given` for all by the rules of the command line: one with `=` has that other name by a
 * rule of its own, one with `-` is ended at once, and one with `!` does without the rules of the command line. With FAKE_WITHIN, it uses intra-process communication as rclcpp does, and
 * only a subscription of the process gets its messages; where that is `both`, one elsewhere does as well, and where it is
 * `untold`, tracetools is not called, as by rclcpp of Humble.
 * With FAKE_LOADS, it does nothing but what it reads, a line each, and says when that is done: `+NAME` creates a node of that
 * full name with a publisher on the topic, `.NAME` removes the publisher of the last such node, `-NAME` ends the node. */
#define _GNU_SOURCE
#include "fake_rclcpp.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

struct allocator {
  void *functions[5];
};

int rcl_init(int, const char *const *, const void *, void *);
int rcl_node_init(void *, const char *, const char *, void *, const void *);
int rcl_node_fini(void *);
int rcl_publisher_init(void *, const void *, const void *, const char *, const void *);
int rcl_publisher_fini(void *, void *);
int rcl_publish(const void *, const void *, void *);
int rcl_subscription_init(void *, const void *, const void *, const char *, const void *);
int rcl_take(const void *, void *, void *, void *);
int rcl_timer_init2(int *, void *, void *, int64_t, void *, struct allocator, int);
int rcl_timer_init(int *, void *, void *, int64_t, void *, struct allocator);
int rcl_timer_fini(int *);
int rcl_timer_call(void *);

struct publisher_base {
  const void *publisher;
  int takes_part;
};
void setup(struct publisher_base *, uint64_t, uint64_t **) __asm__(SETUP);
int fake_deliver(const uint64_t *);
void ros_trace_rclcpp_intra_publish(const void *, const void *);

static long long now(void)
{
  struct timespec at;
  clock_gettime(CLOCK_MONOTONIC, &at);
  return at.tv_sec * 1000000000ll + at.tv_nsec;
}

/* The begin of rcl_node_options_t. */
struct node_options {
  struct allocator memory;
  bool use_global_arguments;
  char *local;
};

static void create_nodes(char *names)
{
  static const char *const arguments[] = {"node", "--ros-args", "-r", "topic:=/chat", "-r", "__node:=/given"};
  void *context = NULL;
  rcl_init(6, arguments, NULL, &context);
  for (char *name = strtok(names, ","); name; name = strtok(NULL, ",")) {
    struct node_options options = {.use_global_arguments = true};
    char *end = name + strlen(name) - 1, *local = strchr(name, '=');
    int ends = *end == '-', alone = *end == '!';
    if (ends || alone)
      *end = 0;
    if (local) {
      *local++ = 0;
      options.local = malloc(strlen(local) + sizeof "__node:=");
      strcat(strcpy(options.local, "__node:="), local);
    }
    options.use_global_arguments = !alone;
    void **node = malloc(sizeof *node);
    rcl_node_init(node, name, "", &context, &options);
    if (ends)
      rcl_node_fini(node);
  }
}

/* The nodes of a container, at most one of them with a name. */
static void load_as_told(const char *topic)
{
  enum { MOST = 16 };
  static const char type;
  static struct {
    char *name;
    void *node, *publisher;
  } nodes[MOST];
  char line[300];
  while (fgets(line, sizeof line, stdin)) {
    line[strcspn(line, "\n")] = 0;
    int at = 0;
    for (int each = MOST - 1; each >= 0; each--)
      if (*line == '+' ? !nodes[each].name : nodes[each].name && strcmp(nodes[each].name, line + 1) == 0)
        at = each;
    if (*line == '+') {
      nodes[at].name = strdup(line + 1);
      rcl_node_init(&nodes[at].node, nodes[at].name, "", NULL, NULL);
      rcl_publisher_init(&nodes[at].publisher, &nodes[at].node, &type, topic, NULL);
    } else if (*line == '.') {
      rcl_publisher_fini(&nodes[at].publisher, &nodes[at].node);
    } else {
      rcl_node_fini(&nodes[at].node);
      free(nodes[at].name);
      nodes[at].name = NULL;
    }
    puts("done");
    fflush(stdout);
  }
}

static void *make_timer(void *timer)
{
  rcl_timer_init(timer, NULL, NULL, 0, NULL, (struct allocator){{NULL}});
  return NULL;
}

/* Where there have been timers of this thread: two whose addresses the library looks for at the same place, of which it
 * knows the second behind the first. */
static int *make_elsewhere(void)
{
  enum { APART = 1024 * 16 / sizeof(int) };
  static int timers[APART + 1];
  int *first = timers, *second = &timers[APART];
  pthread_t thread;
  make_timer(first);
  make_timer(second);
  rcl_timer_fini(first);
  make_timer(second);
  rcl_timer_fini(second);
  pthread_create(&thread, NULL, make_timer, second);
  pthread_join(thread, NULL);
  return second;
}

int main(int count, char **arguments)
{
  if (getenv("FAKE_LOADS")) {
    load_as_told(arguments[2]);
    return 0;
  }
  if (getenv("FAKE_NODES"))
    create_nodes(strdup(getenv("FAKE_NODES")));
  static const char type;
  const char *way = count > 6 ? arguments[6] : "";
  void *publisher, *second_publisher, *subscription = NULL, *log;
  const char *first = "/first", *second = getenv("FAKE_SECOND"), *topics = getenv("FAKE_TOPICS");
  uint64_t message[2] = {strtoull(arguments[1], NULL, 10), 0};
  int made, *timer = &made, ticking = 0;
  long long period = atoll(arguments[3]), messages = atoll(arguments[4]), begun = now(), taken = 0;
  rcl_publisher_init(&log, NULL, &type, "/rosout", NULL);
  const char *wanted = getenv("FAKE_OTHERS");
  int others = wanted ? atoi(wanted) : 0;
  void **other = calloc((size_t)others + 1, sizeof *other);
  for (int index = 0; index < others; index++)
    rcl_publisher_init(&other[index], NULL, &type, arguments[2], NULL);
  rcl_publisher_init(&publisher, &first, &type, arguments[2], NULL);
  struct publisher_base base = {&publisher, 0};
  uint64_t registered = 7, *manager = &registered;
  if (getenv("FAKE_WITHIN"))
    setup(&base, registered, &manager);
  if (second)
    rcl_publisher_init(&second_publisher, &second, &type, arguments[2], NULL);
  for (int index = 0; topics && index < atoi(topics); index++) {
    char *name = malloc(256);
    snprintf(name, 256, "%s_%d", arguments[2], index);
    rcl_publisher_init(malloc(sizeof(void *)), &first, &type, name, NULL);
  }
  for (int index = 0; index < others; index++)
    rcl_publisher_fini(&other[index], NULL);
  log = NULL; /* as rcl does, which keeps a copy of it elsewhere */
  if (count > 5 && strcmp(arguments[5], "time") != 0)
    rcl_subscription_init(&subscription, NULL, &type, arguments[5], NULL);
  for (long long number = 1; number <= messages; number++) {
    long long slot = begun + number * period, left;
    while (period && (left = slot - now()) > 0) {
      struct timespec pause = {left / 1000000000, left % 1000000000};
      nanosleep(&pause, NULL);
    }
    if (ticking ? rcl_timer_call(timer) != 0 : subscription && rcl_take(&subscription, message, NULL, NULL) != 0)
      continue;
    if (strcmp(way, "ticks") == 0 && !ticking)
      ticking = rcl_timer_init2(timer, NULL, NULL, period, NULL, (struct allocator){{NULL}}, 1) == 0;
    if (strcmp(way, "elsewhere") == 0 && !ticking) {
      timer = make_elsewhere();
      ticking = 1;
    }
    if (strcmp(way, "pairs") == 0 && ++taken % 2 != 0)
      continue;
    if (strcmp(way, "timer") == 0)
      rcl_timer_call(NULL);
    if (!getenv("FAKE_INPUT_NS"))
      message[1] = (uint64_t)number;
    const char *within = base.takes_part && registered ? getenv("FAKE_WITHIN") : NULL;
    if (within) {
      if (strcmp(within, "untold") != 0)
        ros_trace_rclcpp_intra_publish(&publisher, message);
      fake_deliver(message);
    }
    if (!within || strcmp(within, "both") == 0)
      rcl_publish(&publisher, message, NULL);
    if (strcmp(way, "twice") == 0)
      rcl_publish(&publisher, message, NULL);
    if (second) {
      uint64_t other[2] = {message[0] + 1000, message[1]};
      rcl_publish(&second_publisher, other, NULL);
    }
  }
  if (count > 5 && !subscription) {
    struct timespec used;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
    printf("%.1f\n", (used.tv_sec * 1e9 + used.tv_nsec) / (double)messages);
    return 0;
  }
  for (;;)
    pause();
}
