/* A composable node with a lifecycle, for tests/foreign/container.c, on rcl alone: `managed::Source` publishes its name on `chatter`, 50
 * times a second while it is active. Of lifecycle nodes it has only the service `~/change_state`, which it answers within 1 ms. */
#include "../tests/foreign/composable.h"

#include <lifecycle_msgs/srv/change_state.h>
#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <stdbool.h>

enum { ACTIVATE = 3, DEACTIVATE = 4 };

struct source {
  rcl_publisher_t publisher;
  rcl_service_t changes;
  std_msgs__msg__String message;
  long long slot;
  bool active;
};

static void answer(struct source *source)
{
  rmw_request_id_t id;
  lifecycle_msgs__srv__ChangeState_Request request;
  lifecycle_msgs__srv__ChangeState_Request__init(&request);
  if (rcl_take_request(&source->changes, &id, &request) == RCL_RET_OK) {
    lifecycle_msgs__srv__ChangeState_Response response = {.success = true};
    if (request.transition.id == ACTIVATE || request.transition.id == DEACTIVATE)
      source->active = request.transition.id == ACTIVATE;
    require(rcl_send_response(&source->changes, &id, &response), "response");
  }
  lifecycle_msgs__srv__ChangeState_Request__fini(&request);
}

static void tick(struct composable *self)
{
  struct source *source = self->state;
  answer(source);
  if (now() < source->slot)
    return;
  source->slot += 20000000;
  if (source->active)
    require(rcl_publish(&source->publisher, &source->message, NULL), "publish");
}

static void end(struct composable *self)
{
  struct source *source = self->state;
  require(rcl_publisher_fini(&source->publisher, &self->node), "publisher");
  require(rcl_service_fini(&source->changes, &self->node), "service");
  free(source);
}

const char *create(struct composable *self, const char *plugin, double (*number_of)(const char *, double))
{
  (void)plugin, (void)number_of;
  struct source *source = calloc(1, sizeof *source);
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  rcl_service_options_t service_options = rcl_service_get_default_options();
  source->publisher = rcl_get_zero_initialized_publisher();
  source->changes = rcl_get_zero_initialized_service();
  require(rcl_publisher_init(&source->publisher, &self->node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), "chatter",
                             &options),
          "publisher");
  require(rcl_service_init(&source->changes, &self->node, ROSIDL_GET_SRV_TYPE_SUPPORT(lifecycle_msgs, srv, ChangeState),
                           "~/change_state", &service_options),
          "service");
  std_msgs__msg__String__init(&source->message);
  rosidl_runtime_c__String__assign(&source->message.data, instance_of(&self->node));
  source->slot = now() + 20000000;
  self->state = source;
  self->period = 1000000;
  self->tick = tick;
  self->end = end;
  return NULL;
}
