/* A node on rcl alone that serves a ROS action: `action_server PERIOD_NS --ros-args …`.
 *
 * Once a period it publishes "NAME NUMBER" on `chatter`, where NAME is that of its instance. On `count` it takes goals of
 * test_msgs/action/Fibonacci, which it notes in the file `executed` of its folder, as "UUID NAME", and counts to their order
 * at 20 Hz, with feedback, or until they are cancelled. */
#include "rcl_require.h"

#include <rcl_action/rcl_action.h>
#include <rcl_action/wait.h>
#include <std_msgs/msg/string.h>
#include <rosidl_runtime_c/string_functions.h>
#include <string.h>
#include <test_msgs/action/fibonacci.h>

#define MOST 64
#define STEP 50000000ll /* ns between two numbers */

struct running {
  rcl_action_goal_handle_t *handle; /* NULL: the place is free */
  uint8_t id[16];
  int order, counted;
  long long due;
  int8_t status; /* 0: it goes on */
  rmw_request_id_t waiting[4]; /* who has asked for the result */
  int waits;
};

static struct running goals[MOST];
static rcl_action_server_t server;
static const char *name;
static FILE *executed;

static struct running *find(const uint8_t *id)
{
  for (int index = 0; index < MOST; index++)
    if (goals[index].handle && memcmp(goals[index].id, id, 16) == 0)
      return &goals[index];
  return NULL;
}

static void publish_status(void)
{
  rcl_action_goal_status_array_t status = rcl_action_get_zero_initialized_goal_status_array();
  require(rcl_action_get_goal_status_array(&server, &status), "status");
  require(rcl_action_publish_status(&server, &status.msg), "publish status");
  require(rcl_action_goal_status_array_fini(&status), "status");
}

static void respond(const struct running *goal, rmw_request_id_t *asked)
{
  test_msgs__action__Fibonacci_GetResult_Response response;
  test_msgs__action__Fibonacci_GetResult_Response__init(&response);
  response.status = goal ? goal->status : 0;
  if (goal) {
    rosidl_runtime_c__int32__Sequence__init(&response.result.sequence, (size_t)goal->counted);
    for (int number = 0; number < goal->counted; number++)
      response.result.sequence.data[number] = number;
  }
  require(rcl_action_send_result_response(&server, asked, &response), "result");
  test_msgs__action__Fibonacci_GetResult_Response__fini(&response);
}

static void end(struct running *goal, rcl_action_goal_event_t event, int8_t status)
{
  require(rcl_action_update_goal_state(goal->handle, event), "end");
  goal->status = status;
  require(rcl_action_notify_goal_done(&server), "done");
  publish_status();
  while (goal->waits)
    respond(goal, &goal->waiting[--goal->waits]);
}

static void take_goal(void)
{
  test_msgs__action__Fibonacci_SendGoal_Request request;
  test_msgs__action__Fibonacci_SendGoal_Response response;
  rmw_request_id_t asked;
  test_msgs__action__Fibonacci_SendGoal_Request__init(&request);
  test_msgs__action__Fibonacci_SendGoal_Response__init(&response);
  if (rcl_action_take_goal_request(&server, &asked, &request) == RCL_RET_OK) {
    struct running *goal = goals;
    while (goal < goals + MOST && goal->handle)
      goal++;
    response.accepted = goal < goals + MOST;
    if (response.accepted) {
      rcl_action_goal_info_t info = rcl_action_get_zero_initialized_goal_info();
      memcpy(info.goal_id.uuid, request.goal_id.uuid, 16);
      memset(goal, 0, sizeof *goal);
      goal->handle = rcl_action_accept_new_goal(&server, &info);
      if (!goal->handle)
        require(RCL_RET_ERROR, "accept");
      memcpy(goal->id, info.goal_id.uuid, 16);
      goal->order = request.goal.order;
      goal->due = now();
      require(rcl_action_update_goal_state(goal->handle, GOAL_EVENT_EXECUTE), "execute");
      for (int index = 0; index < 16; index++)
        fprintf(executed, "%02x", goal->id[index]);
      fprintf(executed, " %s\n", name);
    }
    require(rcl_action_send_goal_response(&server, &asked, &response), "goal");
    publish_status();
  } else {
    rcl_reset_error();
  }
  test_msgs__action__Fibonacci_SendGoal_Request__fini(&request);
}

static void take_cancel(void)
{
  rcl_action_cancel_request_t request = rcl_action_get_zero_initialized_cancel_request();
  rcl_action_cancel_response_t response = rcl_action_get_zero_initialized_cancel_response();
  rmw_request_id_t asked;
  if (rcl_action_take_cancel_request(&server, &asked, &request) != RCL_RET_OK) {
    rcl_reset_error();
    return;
  }
  require(rcl_action_process_cancel_request(&server, &request, &response), "cancel");
  for (size_t index = 0; index < response.msg.goals_canceling.size; index++) {
    struct running *goal = find(response.msg.goals_canceling.data[index].goal_id.uuid);
    require(rcl_action_update_goal_state(goal->handle, GOAL_EVENT_CANCEL_GOAL), "canceling");
  }
  require(rcl_action_send_cancel_response(&server, &asked, &response.msg), "cancel");
  for (size_t index = 0; index < response.msg.goals_canceling.size; index++)
    end(find(response.msg.goals_canceling.data[index].goal_id.uuid), GOAL_EVENT_CANCELED, 5);
  require(rcl_action_cancel_response_fini(&response), "cancel");
}

static void take_result(void)
{
  test_msgs__action__Fibonacci_GetResult_Request request;
  rmw_request_id_t asked;
  test_msgs__action__Fibonacci_GetResult_Request__init(&request);
  if (rcl_action_take_result_request(&server, &asked, &request) != RCL_RET_OK) {
    rcl_reset_error();
    return;
  }
  struct running *goal = find(request.goal_id.uuid);
  if (goal && !goal->status && goal->waits < 4)
    goal->waiting[goal->waits++] = asked;
  else
    respond(goal, &asked);
}

static void expire(void)
{
  rcl_action_goal_info_t expired[MOST];
  size_t number = 0;
  require(rcl_action_expire_goals(&server, expired, MOST, &number), "expire");
  for (size_t index = 0; index < number; index++) {
    struct running *goal = find(expired[index].goal_id.uuid);
    if (goal)
      goal->handle = NULL; /* which rcl has destroyed */
  }
}

static void count_on(void)
{
  for (struct running *goal = goals; goal < goals + MOST; goal++) {
    if (!goal->handle || goal->status || now() < goal->due)
      continue;
    goal->due += STEP;
    if (goal->counted == goal->order) {
      end(goal, GOAL_EVENT_SUCCEED, 4);
      continue;
    }
    goal->counted++;
    test_msgs__action__Fibonacci_FeedbackMessage feedback;
    test_msgs__action__Fibonacci_FeedbackMessage__init(&feedback);
    memcpy(feedback.goal_id.uuid, goal->id, 16);
    require(rcl_action_publish_feedback(&server, &feedback), "feedback");
    test_msgs__action__Fibonacci_FeedbackMessage__fini(&feedback);
  }
}

int main(int count, char **arguments)
{
  rcl_context_t context;
  rcl_node_t node;
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  rcl_action_server_options_t server_options = rcl_action_server_get_default_options();
  rcl_wait_set_t set = rcl_get_zero_initialized_wait_set();
  rcl_clock_t clock;
  rcl_allocator_t memory = rcl_get_default_allocator();
  start_node(count, arguments, "server", &context, &node);
  require(rcl_publisher_init(&publisher, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String), "chatter",
                             &publisher_options),
          "publisher");
  require(rcl_clock_init(RCL_STEADY_TIME, &clock, &memory), "clock");
  server = rcl_action_get_zero_initialized_server();
  require(rcl_action_server_init(&server, &node, &clock, ROSIDL_GET_ACTION_TYPE_SUPPORT(test_msgs, Fibonacci), "count",
                                 &server_options),
          "action server");
  size_t subscriptions, guards, timers, clients, services;
  require(rcl_action_server_wait_set_get_num_entities(&server, &subscriptions, &guards, &timers, &clients, &services),
          "entities");
  require(rcl_wait_set_init(&set, subscriptions, guards, timers, clients, services, 0, &context, memory), "wait set");
  executed = fopen("executed", "a");
  if (!executed)
    return 1;
  setvbuf(executed, NULL, _IOLBF, 0);
  name = instance_of(&node);
  long long period = atoll(arguments[1]), slot = now();
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  for (long long number = 1;;) {
    if (now() >= slot) {
      char text[300];
      snprintf(text, sizeof text, "%s %lld", name, number++);
      rosidl_runtime_c__String__assign(&message.data, text);
      require(rcl_publish(&publisher, &message, NULL), "publish");
      slot += period;
    }
    count_on();
    require(rcl_wait_set_clear(&set), "clear");
    require(rcl_action_wait_set_add_action_server(&set, &server, NULL), "add");
    long long left = slot - now();
    rcl_ret_t result = rcl_wait(&set, left > 0 ? left : 0);
    if (result == RCL_RET_TIMEOUT)
      continue;
    require(result, "wait");
    bool goal = false, cancel = false, asked = false, expired = false;
    require(rcl_action_server_wait_set_get_entities_ready(&set, &server, &goal, &cancel, &asked, &expired), "ready");
    if (goal)
      take_goal();
    if (cancel)
      take_cancel();
    if (asked)
      take_result();
    if (expired)
      expire();
  }
}
