/* A node on rcl alone that publishes as rclcpp does with intra-process communication: `within PERIOD_NS TOPIC BYTES …`.
 *
 * A reader in its process gets each message, a String of so many bytes; before, it calls tracetools as rclcpp does (from
 * Iron on). Only if there is a reader elsewhere, the message is published by rcl as well, which serializes it. */
#include "rcl_require.h"

#include <std_msgs/msg/string.h>
#include <stdint.h>
#include <string.h>

void ros_trace_rclcpp_intra_publish(const void *publisher, const void *message);

static volatile uint64_t heard;

/* The reader in the process: it looks at each message. */
static void take(const std_msgs__msg__String *message)
{
  heard += message->data.size + (uint64_t)message->data.data[0];
}

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  start_node(count, arguments, "within", &context, &node);
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  require(rcl_publisher_init(&publisher, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), arguments[2],
                             &options),
          arguments[2]);
  long long period = atoll(arguments[1]), slot = now();
  size_t size = strtoull(arguments[3], NULL, 10), readers = 0;
  for (;;) {
    std_msgs__msg__String *message = calloc(1, sizeof *message); /* a new one each time, as a unique_ptr is */
    message->data.data = malloc(size + 1);
    memset(message->data.data, 'x', size);
    message->data.data[size] = 0;
    message->data.size = size;
    message->data.capacity = size + 1;
    ros_trace_rclcpp_intra_publish(&publisher, message);
    require(rcl_publisher_get_subscription_count(&publisher, &readers), "readers");
    if (readers)
      require(rcl_publish(&publisher, message, NULL), "publish");
    take(message);
    free(message->data.data);
    free(message);
    slot += period;
    struct timespec at = {slot / 1000000000, slot % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
  }
}
