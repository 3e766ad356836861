/* A node on rcl alone that records what it hears: `listener TOPIC FILE --ros-args …`.
 *
 * For each message of type std_msgs/msg/String it writes a line: when it was taken (monotonic, ns), and the text. */
#include "rcl_require.h"

#include <std_msgs/msg/string.h>

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  rcl_subscription_t subscription = rcl_get_zero_initialized_subscription();
  rcl_subscription_options_t subscription_options = rcl_subscription_get_default_options();
  rcl_wait_set_t waiting = rcl_get_zero_initialized_wait_set();
  FILE *file = fopen(arguments[2], "w");
  if (!file) {
    perror(arguments[2]);
    return 1;
  }
  start_node(count, arguments, "recorder", &context, &node);
  subscription_options.qos.depth = 5000; /* it may not be given a core for a while */
  require(rcl_subscription_init(&subscription, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), arguments[1],
                                &subscription_options),
          arguments[1]);
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
      fprintf(file, "%lld %s\n", now(), message.data.data);
    }
    rcl_reset_error();
    fflush(file);
  }
}
