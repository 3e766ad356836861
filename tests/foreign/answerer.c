/* A node on rcl alone that answers messages: `answerer TOPIC ANSWERS --ros-args …`.
 *
 * It answers "NAME NUMBER" on TOPIC by "INSTANCE NUMBER" on ANSWERS, in the thread that has taken it. */
#include "rcl_require.h"

#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <string.h>

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  rcl_subscription_t subscription = rcl_get_zero_initialized_subscription();
  rcl_subscription_options_t subscription_options = rcl_subscription_get_default_options();
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  rcl_wait_set_t waiting = rcl_get_zero_initialized_wait_set();
  subscription_options.qos.depth = publisher_options.qos.depth = 1000; /* a process may be late */
  start_node(count, arguments, "answerer", &context, &node);
  const rosidl_message_type_support_t *type = ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String);
  require(rcl_publisher_init(&publisher, &node, type, arguments[2], &publisher_options), arguments[2]);
  require(rcl_subscription_init(&subscription, &node, type, arguments[1], &subscription_options), arguments[1]);
  require(rcl_wait_set_init(&waiting, 1, 0, 0, 0, 0, 0, &context, rcl_get_default_allocator()), "wait set");
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  for (;;) {
    require(rcl_wait_set_clear(&waiting), "wait set");
    require(rcl_wait_set_add_subscription(&waiting, &subscription, NULL), "wait set");
    rcl_ret_t woken = rcl_wait(&waiting, 1000000000);
    if (woken != RCL_RET_TIMEOUT)
      require(woken, "wait");
    while (rcl_take(&subscription, &message, NULL, NULL) == RCL_RET_OK) {
      char text[300];
      snprintf(text, sizeof text, "%s%s", instance_of(&node), strchr(message.data.data, ' '));
      rosidl_runtime_c__String__assign(&message.data, text);
      require(rcl_publish(&publisher, &message, NULL), "publish");
    }
    rcl_reset_error();
  }
}
