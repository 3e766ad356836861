/* A node on rcl that publishes as fast as it can: `rcl_publisher TOPIC MESSAGES`.
 *
 * Prints, in ns: the time of one message in the mean, then the median and the 99 % quantile of single calls.
 * `rcl_publisher TOPIC MESSAGES PERIOD` publishes one in each period (us) as soon as there is a subscriber, and prints
 * nothing: each message is the time when it is published (monotonic, ns). */
#include "../tests/foreign/rcl_require.h"

#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>

static int compare(const void *one, const void *other)
{
  long long a = *(const long long *)one, b = *(const long long *)other;
  return (a > b) - (a < b);
}

static void publish_times(rcl_publisher_t *publisher, std_msgs__msg__String *message, long messages, long long period)
{
  size_t subscribers = 0;
  struct timespec shortly = {0, 10000000};
  while (!subscribers) {
    nanosleep(&shortly, NULL);
    require(rcl_publisher_get_subscription_count(publisher, &subscribers), "subscribers");
  }
  long long next = now() + 1000000000; /* the subscriber may not have found the publisher yet */
  for (long number = 0; number < messages; number++, next += period) {
    struct timespec at = {next / 1000000000, next % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
    char text[24];
    snprintf(text, sizeof text, "%lld", now());
    rosidl_runtime_c__String__assign(&message->data, text);
    require(rcl_publish(publisher, message, NULL), "publish");
  }
  require(rcl_publisher_wait_for_all_acked(publisher, 5000000000), "acknowledgement");
}

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  start_node(count, arguments, "publisher", &context, &node);
  require(rcl_publisher_init(&publisher, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), arguments[1],
                             &publisher_options),
          arguments[1]);
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  long messages = atol(arguments[2]);
  if (count > 3) {
    publish_times(&publisher, &message, messages, atoll(arguments[3]) * 1000);
    return 0;
  }
  rosidl_runtime_c__String__assign(&message.data, "a message of the gate's benchmark");
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
