/* A node on rcl alone, without a client library: `talker PERIOD_NS TOPIC… --ros-args …`.
 *
 * Once a period it publishes "NAME NUMBER" on each topic, where NAME is that of its node. With a period of 0 it publishes
 * one message, and then none. */
#include "rcl_require.h"

#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <string.h>
#include <unistd.h>

#define MOST 8

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  start_node(count, arguments, "c_talker", &context, &node);
  rcl_publisher_t publishers[MOST];
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  publisher_options.qos.depth = 1000; /* a listener may be late */
  int topics = 0;
  while (topics < MOST && topics + 2 < count && strcmp(arguments[topics + 2], "--ros-args") != 0) {
    publishers[topics] = rcl_get_zero_initialized_publisher();
    require(rcl_publisher_init(&publishers[topics], &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String),
                               arguments[topics + 2], &publisher_options),
            arguments[topics + 2]);
    topics++;
  }
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  long long period = atoll(arguments[1]);
  long long slot = now();
  for (long long number = 1;; number++) {
    char text[300];
    snprintf(text, sizeof text, "%s %lld", instance_of(&node), number);
    rosidl_runtime_c__String__assign(&message.data, text);
    for (int topic = 0; topic < topics; topic++)
      require(rcl_publish(&publishers[topic], &message, NULL), "publish");
    while (period == 0)
      pause();
    slot += period;
    struct timespec at = {slot / 1000000000, slot % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
  }
}
