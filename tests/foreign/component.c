/* A library with composable nodes: `demo::Talker` publishes "INSTANCE NUMBER TEXT" on `chatter`, 50 times a second,
 * and begins to count after the parameter `first`; `demo::Maker` does so as well, and has made a node `/made/inner`;
 * `demo::Failing` cannot be made, and `demo::Crashing` ends its process. TEXT is set when it is compiled.
 * The file STAND_IN_FAULTS in its environment has lines `NODE FAULT`: with `abort`, a node of that full name ends the process
 * as it is made; with `hang`, its constructor does not return as long as that line is there; nor does its destructor with
 * `linger`. With `stay`, its container answers that it has unloaded it, while the node is still there, and nothing else from
 * then on, as where another thread of an executor has stopped in what was destroyed. What hangs is only ended by a kill. */
#include "composable.h"

#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <signal.h>
#include <string.h>

#ifndef TEXT
#define TEXT "old"
#endif

struct talker {
  rcl_publisher_t publisher;
  std_msgs__msg__String message;
  long long number;
  rcl_node_t inner;
};

static bool has_fault(const struct composable *self, const char *fault)
{
  const char *path = getenv("STAND_IN_FAULTS");
  FILE *file = path ? fopen(path, "r") : NULL;
  char node[300], found[300];
  bool known = false;
  while (file && !known && fscanf(file, "%299s %299s", node, found) == 2)
    known = strcmp(node, rcl_node_get_fully_qualified_name(&self->node)) == 0 && strcmp(found, fault) == 0;
  if (file)
    fclose(file);
  return known;
}

static void talk(struct composable *self)
{
  struct talker *talker = self->state;
  char text[300];
  snprintf(text, sizeof text, "%s-" TEXT " %lld", instance_of(&self->node), ++talker->number);
  rosidl_runtime_c__String__assign(&talker->message.data, text);
  require(rcl_publish(&talker->publisher, &talker->message, NULL), "publish");
}

static void wait_while(const struct composable *self, const char *fault)
{
  bool hangs = has_fault(self, fault);
  for (int asked = 0; hangs && asked < 2; asked++)
    signal(asked ? SIGTERM : SIGINT, SIG_IGN);
  for (struct timespec moment = {0, 10000000}; has_fault(self, fault);)
    nanosleep(&moment, NULL);
  for (int asked = 0; hangs && asked < 2; asked++)
    signal(asked ? SIGTERM : SIGINT, SIG_DFL);
}

static void stay(struct composable *self)
{
  wait_while(self, "stay");
}

static bool stop(struct composable *self)
{
  struct talker *talker = self->state;
  if (has_fault(self, "stay"))
    return false;
  wait_while(self, "linger");
  require(rcl_publisher_fini(&talker->publisher, &self->node), "publisher");
  std_msgs__msg__String__fini(&talker->message);
  if (rcl_node_is_valid(&talker->inner))
    require(rcl_node_fini(&talker->inner), "inner node");
  rcl_reset_error();
  free(talker);
  return true;
}

const char *create(struct composable *self, const char *plugin, double (*number_of)(const char *, double))
{
  if (strcmp(plugin, "demo::Failing") == 0)
    return "Component constructor threw an exception: no device";
  if (strcmp(plugin, "demo::Crashing") == 0 || has_fault(self, "abort"))
    abort();
  wait_while(self, "hang");
  struct talker *talker = calloc(1, sizeof *talker);
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  options.qos.depth = 1000; /* a listener may be late */
  talker->publisher = rcl_get_zero_initialized_publisher();
  require(rcl_publisher_init(&talker->publisher, &self->node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String),
                             "chatter", &options),
          "publisher");
  std_msgs__msg__String__init(&talker->message);
  talker->inner = rcl_get_zero_initialized_node();
  if (strcmp(plugin, "demo::Maker") == 0) {
    rcl_node_options_t inner = rcl_node_get_default_options();
    require(rcl_node_init(&talker->inner, "inner", "/made", self->node.context, &inner), "inner node");
  }
  self->state = talker;
  talker->number = number_of("first", 0);
  self->period = 20000000;
  self->tick = talk;
  self->end = stop;
  self->stay = stay;
  return NULL;
}
