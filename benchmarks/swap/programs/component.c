/* Composable nodes for the tests' stand-in of a container (tests/foreign/container.c), on rcl alone: both publish on `chatter`, with the
 * parameters `rate` (Hz) and `size` (characters). `swap::Source` does so from its start. `swap::Managed` does so while it is active; of
 * lifecycle nodes it has only the service `~/change_state`, which it answers within 1 ms. A message is as content.py makes it. */
#include "../../../tests/foreign/composable.h"

#include <lifecycle_msgs/srv/change_state.h>
#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/string.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

enum { ACTIVATE = 3, DEACTIVATE = 4, HEAD = 400 };

struct source {
  rcl_publisher_t publisher;
  rcl_service_t changes;
  std_msgs__msg__String message;
  char talker[300], *text;
  size_t size;
  long long number, period, slot;
  bool managed, active;
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
  rcl_reset_error();
  lifecycle_msgs__srv__ChangeState_Request__fini(&request);
}

static void publish(struct source *source)
{
  char head[HEAD];
  size_t length = snprintf(head, sizeof head, "%s %lld %lld ", source->talker, ++source->number, now());
  memset(source->text, 'x', source->size < HEAD ? source->size : HEAD); /* the head before may have been longer */
  memcpy(source->text, head, length);
  rosidl_runtime_c__String__assignn(&source->message.data, source->text, source->size > length ? source->size : length);
  require(rcl_publish(&source->publisher, &source->message, NULL), "publish");
}

static void tick(struct composable *self)
{
  struct source *source = self->state;
  if (source->managed)
    answer(source);
  if (now() < source->slot)
    return;
  source->slot += source->period;
  if (source->active)
    publish(source);
}

static bool end(struct composable *self)
{
  struct source *source = self->state;
  require(rcl_publisher_fini(&source->publisher, &self->node), "publisher");
  if (source->managed)
    require(rcl_service_fini(&source->changes, &self->node), "service");
  std_msgs__msg__String__fini(&source->message);
  free(source->text);
  free(source);
  return true;
}

static void stay(struct composable *self)
{
  (void)self;
}

const char *create(struct composable *self, const char *plugin, double (*number_of)(const char *, double))
{
  struct source *source = calloc(1, sizeof *source);
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  rcl_service_options_t service_options = rcl_service_get_default_options();
  source->managed = strcmp(plugin, "swap::Managed") == 0;
  source->active = !source->managed;
  source->publisher = rcl_get_zero_initialized_publisher();
  source->changes = rcl_get_zero_initialized_service();
  require(rcl_publisher_init(&source->publisher, &self->node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), "chatter",
                             &options),
          "publisher");
  if (source->managed)
    require(rcl_service_init(&source->changes, &self->node, ROSIDL_GET_SRV_TYPE_SUPPORT(lifecycle_msgs, srv, ChangeState),
                             "~/change_state", &service_options),
            "service");
  std_msgs__msg__String__init(&source->message);
  source->size = number_of("size", 100);
  source->text = malloc(source->size + HEAD);
  memset(source->text, 'x', source->size + HEAD);
  snprintf(source->talker, sizeof source->talker, "%.200s-%d-%lld", instance_of(&self->node), getpid(), now());
  source->period = 1e9 / number_of("rate", 50);
  source->slot = now() + source->period;
  self->state = source;
  self->period = !source->managed ? source->period : source->period > 4000000 ? 1000000 : source->period / 4;
  self->tick = tick;
  self->end = end;
  self->stay = stay;
  return NULL;
}
