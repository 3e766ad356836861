/* A node on rcl that publishes as fast as it can: `rcl_publisher TOPIC MESSAGES --ros-args …`.
 *
 * Prints, in ns: the time of one message in the mean, then the median and the 99 % quantile of single calls. */
#include "../tests/foreign/rcl_require.h"

#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <time.h>

static long long now(void)
{
  struct timespec at;
  clock_gettime(CLOCK_MONOTONIC, &at);
  return at.tv_sec * 1000000000ll + at.tv_nsec;
}

static int compare(const void *one, const void *other)
{
  long long a = *(const long long *)one, b = *(const long long *)other;
  return (a > b) - (a < b);
}

int main(int count, char **arguments)
{
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  rcl_context_t context = rcl_get_zero_initialized_context();
  rcl_node_t node = rcl_get_zero_initialized_node();
  rcl_node_options_t node_options = rcl_node_get_default_options();
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  require(rcl_init_options_init(&options, rcl_get_default_allocator()), "options");
  require(rcl_init(count, (const char *const *)arguments, &options, &context), "init");
  require(rcl_node_init(&node, "publisher", "", &context, &node_options), "node");
  require(rcl_publisher_init(&publisher, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), arguments[1],
                             &publisher_options),
          arguments[1]);
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  rosidl_runtime_c__String__assign(&message.data, "a message of the gate's benchmark");
  long messages = atol(arguments[2]);
  long long *took = malloc((size_t)messages * sizeof *took);
  for (long number = 0; number < messages / 10; number++) /* until nothing is allocated any more */
    require(rcl_publish(&publisher, &message, NULL), "publish");
  long long begun = now(), before = begun;
  for (long number = 0; number < messages; number++) {
    require(rcl_publish(&publisher, &message, NULL), "publish");
    long long after = now();
    took[number] = after - before;
    before = after;
  }
  double mean = (double)(before - begun) / (double)messages;
  qsort(took, (size_t)messages, sizeof *took, compare);
  printf("%.1f %lld %lld\n", mean, took[messages / 2], took[messages * 99 / 100]);
  return 0;
}
