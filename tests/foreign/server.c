/* A node on rcl alone that serves: `server PERIOD_NS id|info --ros-args …`.
 *
 * Once a period it publishes "NAME NUMBER" on `chatter`, where NAME is that of its node. It notes each request to `count`
 * in the file `calls` of its folder, as "REQUEST NAME", and responds with its name; it takes requests with
 * rcl_take_request, or with rcl_take_request_with_info. A request with a depth gets no response. */
#include "rcl_require.h"

#include <rcl_interfaces/srv/list_parameters.h>
#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <string.h>

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  rcl_service_t service = rcl_get_zero_initialized_service();
  rcl_service_options_t service_options = rcl_service_get_default_options();
  rcl_wait_set_t set = rcl_get_zero_initialized_wait_set();
  start_node(count, arguments, "server", &context, &node);
  require(rcl_publisher_init(&publisher, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), "chatter",
                             &publisher_options),
          "publisher");
  require(rcl_service_init(&service, &node, ROSIDL_GET_SRV_TYPE_SUPPORT(rcl_interfaces, srv, ListParameters), "count",
                           &service_options),
          "service");
  require(rcl_wait_set_init(&set, 0, 0, 0, 0, 1, 0, &context, rcl_get_default_allocator()), "wait set");
  FILE *calls = fopen("calls", "a");
  if (!calls)
    return 1;
  setvbuf(calls, NULL, _IOLBF, 0);
  const char *name = instance_of(&node);
  long long period = atoll(arguments[1]), slot = now();
  bool with_info = strcmp(arguments[2], "info") == 0;
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  for (long long number = 1;;) {
    if (now() >= slot) {
      char text[300];
      snprintf(text, sizeof text, "%s %lld", name, number++);
      rosidl_runtime_c__String__assign(&message.data, text);
      require(rcl_publish(&publisher, &message, NULL), "publish");
      slot += period;
      continue;
    }
    require(rcl_wait_set_clear(&set), "wait set");
    require(rcl_wait_set_add_service(&set, &service, NULL), "wait set");
    long long left = slot - now();
    rcl_ret_t waited = rcl_wait(&set, left > 0 ? left : 0);
    if (waited == RCL_RET_TIMEOUT)
      continue;
    require(waited, "wait");
    rcl_interfaces__srv__ListParameters_Request request;
    rcl_interfaces__srv__ListParameters_Response response;
    rcl_interfaces__srv__ListParameters_Request__init(&request);
    rcl_interfaces__srv__ListParameters_Response__init(&response);
    rmw_service_info_t info = {0};
    rcl_ret_t taken = with_info ? rcl_take_request_with_info(&service, &info, &request)
                                : rcl_take_request(&service, &info.request_id, &request);
    if (taken == RCL_RET_OK)
      fprintf(calls, "%s %s\n", request.prefixes.data[0].data, name);
    if (taken == RCL_RET_OK && !request.depth) {
      rosidl_runtime_c__String__Sequence__init(&response.result.names, 1);
      rosidl_runtime_c__String__assign(&response.result.names.data[0], name);
      require(rcl_send_response(&service, &info.request_id, &response), "response");
    } else if (taken != RCL_RET_OK && taken != RCL_RET_SERVICE_TAKE_FAILED) {
      require(taken, "take");
    }
    rcl_interfaces__srv__ListParameters_Request__fini(&request);
    rcl_interfaces__srv__ListParameters_Response__fini(&response);
  }
}
