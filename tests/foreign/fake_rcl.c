/* In the place of librcl: "publishing" appends to a log in shared memory, and notices when two nodes do so at once. */
#define _GNU_SOURCE
#include "fake_rclcpp.h"

#include <fcntl.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#define RECORDS 4000000

struct log {
  _Atomic uint64_t count;
  _Atomic uint32_t inside; /* the writer that publishes, 0: none */
  _Atomic uint32_t overlaps;
  struct {
    uint64_t writer, number;
    int64_t at;
  } records[RECORDS];
};

struct publisher {
  const char *topic;
};

static struct log *map(void)
{
  static struct log *known;
  if (!known) {
    int file = open(getenv("FAKE_LOG"), O_RDWR);
    known = mmap(NULL, sizeof *known, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
  }
  return known;
}

static int record(const uint64_t *message)
{
  struct log *log = map();
  uint32_t other = atomic_exchange(&log->inside, (uint32_t)message[0]);
  if (other && other != message[0])
    atomic_fetch_add(&log->overlaps, 1);
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  uint64_t index = atomic_fetch_add(&log->count, 1);
  if (index < RECORDS) {
    log->records[index].writer = message[0];
    log->records[index].number = message[1];
    log->records[index].at = now.tv_sec * 1000000000ll + now.tv_nsec;
  }
  atomic_store(&log->inside, 0);
  return 0;
}

int rcl_publish(const void *publisher, const uint64_t *message, void *allocation)
{
  (void)publisher, (void)allocation;
  return record(message);
}

int rcl_publish_serialized_message(const void *publisher, uint8_t *const *message, void *allocation)
{
  (void)publisher, (void)allocation;
  return record((const uint64_t *)*message);
}

int rmw_serialize(const void *message, const void *type, void **bytes)
{
  (void)type;
  struct {
    uint8_t *buffer;
    size_t length, capacity;
    void *(*allocate)(size_t, void *);
  } *out = (void *)bytes;
  out->buffer = out->allocate(16, NULL);
  memcpy(out->buffer, message, 16);
  out->length = out->capacity = 16;
  return 0;
}

/* A node is its name. */
const char *rcl_node_get_fully_qualified_name(const char *const *node)
{
  return node ? *node : NULL;
}

struct allocator {
  void *functions[5];
};

/* Rules are one rule that names nodes; NULL: there is none. A context begins with that of the command line. */
int rcl_init(int count, const char *const *arguments, const void *options, char **context)
{
  (void)options;
  for (int index = 1; index < count; index++)
    if (strcmp(arguments[index - 1], "-r") == 0 && strstr(arguments[index], "__node:="))
      *context = strdup(arguments[index]);
  return 0;
}

/* The name that a rule gives a node. */
static const char *named_by(const char *rule, const char *name)
{
  const char *given = rule ? strstr(rule, "__node:=") : NULL;
  size_t prefix = given ? (size_t)(given - rule) : 0; /* with its colon */
  bool meant = given && (!prefix || (strlen(name) == prefix - 1 && strncmp(rule, name, prefix - 1) == 0));
  return meant ? given + strlen("__node:=") : NULL;
}

__attribute__((noinline))
int rcl_remap_node_name(char *const *local, char *const *global, const char *name, struct allocator memory, char **remapped)
{
  (void)memory;
  const char *given = local ? named_by(*local, name) : NULL;
  given = given || !global ? given : named_by(*global, name);
  *remapped = given ? strdup(given) : NULL;
  return 0;
}

/* The begin of rcl_node_options_t. */
struct node_options {
  struct allocator memory;
  bool use_global_arguments;
  char *local;
};

/* As that of rcl: it applies the rules by a call that a library before this one sees, or not, as this one is linked. */
int rcl_node_init(const char **node, const char *name, const char *namespace, char *const *context,
                  const struct node_options *options)
{
  char *remapped = NULL;
  (void)namespace;
  if (options)
    rcl_remap_node_name(&options->local, options->use_global_arguments ? context : NULL, name, options->memory, &remapped);
  *node = strdup(remapped ? remapped : name);
  return 0;
}

int rcl_node_fini(const char **node)
{
  *node = NULL;
  return 0;
}

int rcl_publisher_init(struct publisher *publisher, const void *node, const void *type, const char *name, const void *options)
{
  (void)node, (void)type, (void)options;
  publisher->topic = name;
  return 0;
}

int rcl_publisher_fini(struct publisher *publisher, void *node)
{
  (void)publisher, (void)node;
  return 0;
}

const char *rcl_publisher_get_topic_name(const struct publisher *publisher)
{
  return publisher->topic;
}

/* With FAKE_LATCHED, every publisher is latched, and that is its depth. */
const void *rcl_publisher_get_actual_qos(const struct publisher *publisher)
{
  static struct {
    int history;
    size_t depth;
    int reliability, durability;
  } latched = {1, 0, 1, 1};
  (void)publisher;
  if (!getenv("FAKE_LATCHED"))
    return NULL;
  latched.depth = strtoull(getenv("FAKE_LATCHED"), NULL, 10);
  return &latched;
}

int rcl_subscription_init(struct publisher *subscription, const void *node, const void *type, const char *name, const void *options)
{
  (void)node, (void)type, (void)options;
  subscription->topic = name;
  return 0;
}

const char *rcl_subscription_get_topic_name(const struct publisher *subscription)
{
  return subscription->topic;
}

/* rmw_message_info_t */
struct message_info {
  int64_t sent, received;
  uint64_t number, reception;
  const char *implementation;
  uint8_t writer[16];
};

/* There always is a message. With FAKE_INPUT_NS, there is one in each such time, which has its number. */
int rcl_take(const void *subscription, uint64_t *message, struct message_info *info, void *allocation)
{
  static uint64_t period, number;
  struct timespec now;
  (void)subscription, (void)allocation;
  if (!getenv("FAKE_INPUT_NS"))
    return 0;
  period = strtoull(getenv("FAKE_INPUT_NS"), NULL, 10);
  clock_gettime(CLOCK_MONOTONIC, &now);
  uint64_t last = ((uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec) / period;
  if (!number)
    number = last;
  if (number >= last)
    return 401; /* RCL_RET_SUBSCRIPTION_TAKE_FAILED */
  message[1] = info->number = ++number;
  memcpy(info->writer, "a writer of them", 16);
  return 0;
}

/* A timer is how often it has been due; all of them have one callback. */
static void *timer_callback;

__attribute__((noinline))
int rcl_timer_init2(int *timer, void *clock, void *context, int64_t period, void *callback, struct allocator memory,
                    int starts)
{
  (void)clock, (void)context, (void)period, (void)memory, (void)starts;
  *timer = 0;
  timer_callback = callback;
  return 0;
}

/* As that of rcl: the first one calls the other. */
int rcl_timer_init(int *timer, void *clock, void *context, int64_t period, void *callback, struct allocator memory)
{
  return rcl_timer_init2(timer, clock, context, period, callback, memory, 1);
}

int rcl_timer_fini(int *timer)
{
  *timer = 0;
  return 0;
}

void *rcl_timer_exchange_callback(int *timer, void *callback)
{
  void *before = timer_callback;
  (void)timer;
  timer_callback = callback;
  return before;
}

__attribute__((noinline))
int rcl_timer_call_with_info(int *timer, int64_t *info)
{
  info[0] = info[1] = 0;
  if (timer)
    ++*timer;
  if (timer_callback)
    ((void (*)(void *, int64_t))timer_callback)(timer, 0);
  return 0;
}

/* As that of rcl: it calls the other one. */
int rcl_timer_call(int *timer)
{
  int64_t info[2];
  return rcl_timer_call_with_info(timer, info);
}

int rcl_publisher_get_subscription_count(const struct publisher *publisher, size_t *count)
{
  *count = publisher->topic[0] ? 3 : 0;
  return 0;
}

int rcl_subscription_get_publisher_count(const struct publisher *subscription, size_t *count)
{
  *count = subscription->topic[0] ? 3 : 0;
  return 0;
}

/* A server is the name of its service. There always is a request, from one client, which the middleware has received
 * FAKE_RECEIVED_MS ago. */
struct request_id {
  uint8_t client[16];
  int64_t number;
};

struct request_info {
  int64_t sent, received;
  struct request_id id;
};

__attribute__((noinline))
int rcl_service_init(const char **service, const void *node, const void *type, const char *name, const void *options)
{
  (void)node, (void)type, (void)options;
  *service = name;
  return 0;
}

const void *rosidl_typesupport_c__get_service_type_support_handle__type_description_interfaces__srv__GetTypeDescription(void)
{
  static const void *const type[5] = {"of a test", NULL, NULL, "request", "response"};
  return type;
}

/* As that of rcl: it makes a server by a call that a library before this one sees, or not, as this one is linked. */
int rcl_node_type_description_service_init(const char **service, const char *const *node)
{
  static const uint64_t options[16];
  static char name[256];
  strcat(strcpy(name, *node), "/get_type_description");
  const void *type =
      rosidl_typesupport_c__get_service_type_support_handle__type_description_interfaces__srv__GetTypeDescription();
  return rcl_service_init(service, node, type, name, options);
}

int rcl_service_fini(const char **service, void *node)
{
  (void)service, (void)node;
  return 0;
}

const char *rcl_service_get_service_name(const char *const *service)
{
  return *service;
}

/* With HUMBLE, as there: the type of a service has not those of its messages, and clients are counted by the topic on which
 * implementations over DDS have their requests. */
#ifdef HUMBLE
int rcl_get_publishers_info_by_topic(const void *node, const void *memory, const char *topic, bool no_mangle, size_t *found)
{
  (void)node, (void)memory;
  *found = no_mangle && strcmp(topic, "rq/countRequest") == 0 ? 2 : 0;
  return 0;
}

int rmw_topic_endpoint_info_array_fini(size_t *found, const void *memory)
{
  (void)memory;
  *found = 0;
  return 0;
}
#else
void *rcl_service_configure_service_introspection(void)
{
  return NULL;
}

int rcl_count_clients(const void *node, const char *service, size_t *count)
{
  (void)node;
  *count = strcmp(service, "/count") == 0 ? 2 : 0;
  return 0;
}
#endif

#ifdef CYCLONE
const char *rmw_get_implementation_identifier(void)
{
  return "rmw_cyclonedds_cpp";
}
#endif

static int take_request(const void *service, struct request_info *info, void *request)
{
  static int64_t number, ago = -1;
  struct timespec now;
  (void)service, (void)request;
  if (ago < 0)
    ago = getenv("FAKE_RECEIVED_MS") ? atoll(getenv("FAKE_RECEIVED_MS")) : 0;
  if (ago)
    clock_gettime(CLOCK_REALTIME, &now);
  memset(info, 0, sizeof *info);
  info->received = ago ? now.tv_sec * 1000000000ll + now.tv_nsec - ago * 1000000 : 0;
  memcpy(info->id.client, "a client of it", 15);
#ifdef CYCLONE /* half of the client is a number that it has in this process alone */
  uint64_t here = (uint64_t)getpid();
  memcpy(info->id.client + 8, &here, sizeof here);
#endif
  info->id.number = ++number;
  return 0;
}

int rcl_take_request_with_info(const void *service, struct request_info *info, void *request)
{
  return take_request(service, info, request);
}

/* As with -Bsymbolic-functions, by which a library's calls of its functions reach no preloaded library. */
int rcl_take_request(const void *service, struct request_id *id, void *request)
{
  struct request_info info;
  int result = take_request(service, &info, request);
  *id = info.id;
  return result;
}

int rcl_send_response(const void *service, struct request_id *id, void *response)
{
  (void)service, (void)id, (void)response;
  return 0;
}

int rcl_client_init(void **client, const void *node, const void *type, const char *name, const void *options)
{
  (void)node, (void)type, (void)name, (void)options;
  *client = client;
  return 0;
}

int rcl_client_fini(void **client, void *node)
{
  (void)node;
  *client = NULL;
  return 0;
}

/* There always is a response. */
int rcl_take_response(const void *client, struct request_id *id, void *response)
{
  (void)client, (void)id, (void)response;
  return 0;
}

int rcl_take_response_with_info(const void *client, struct request_info *info, void *response)
{
  return rcl_take_response(client, &info->id, response);
}

/* Nothing comes. */
int rcl_wait(const void *set, int64_t timeout)
{
  (void)set;
  struct timespec pause = {timeout / 1000000000, timeout % 1000000000};
  nanosleep(&pause, NULL);
  return 2;
}

int rmw_deserialize(const void *bytes, const void *type, void *message)
{
  (void)bytes, (void)type, (void)message;
  return 0;
}

void rcutils_reset_error(void)
{
}

int rcl_service_set_on_new_request_callback(const void *service, const void *callback, const void *context)
{
  (void)service, (void)callback, (void)context;
  return 0;
}

/* -- in the place of librclcpp, with its names --------------------------------------------------------------------------- */

struct manager {
  uint64_t registered; /* the number of the publisher, 0: none */
};

struct publisher_base {
  const struct publisher *publisher;
  int takes_part;
};

const char *topic_name(const struct publisher_base *base) __asm__("_ZNK6rclcpp13PublisherBase14get_topic_nameEv");
void remove_publisher(struct manager *manager, uint64_t number)
    __asm__("_ZN6rclcpp12experimental19IntraProcessManager16remove_publisherEm");
void setup(struct publisher_base *base, uint64_t number, struct manager **manager) __asm__(SETUP);

const char *topic_name(const struct publisher_base *base)
{
  return rcl_publisher_get_topic_name(base->publisher);
}

void remove_publisher(struct manager *manager, uint64_t number)
{
  if (manager->registered == number)
    manager->registered = 0;
}

void setup(struct publisher_base *base, uint64_t number, struct manager **manager)
{
  (void)number, (void)manager;
  base->takes_part = 1;
}

/* Of tracetools: rclcpp calls them before and after each callback, and with each message before subscriptions of the process
 * get it. */
void ros_trace_callback_start(const void *callback, bool within)
{
  (void)callback, (void)within;
}

void ros_trace_callback_end(const void *callback)
{
  (void)callback;
}

void ros_trace_rclcpp_intra_publish(const void *publisher, const void *message)
{
  (void)publisher, (void)message;
}

/* A subscription of the process gets a message. */
int fake_deliver(const uint64_t *message)
{
  return record(message);
}
