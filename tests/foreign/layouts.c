/* The structures that the library of the gate declares itself, compared with those of the headers of the installed ROS: it
 * compiles where they agree. */
#include <rcl/graph.h>
#include <rcl/rcl.h>
#include <rcl_action/types.h>
#include <rmw/types.h>
#include <rosidl_runtime_c/service_type_support_struct.h>

#include "page.h"
#include "rcl.h"

#define SAME(own, member, real, real_member)                                                                             \
  _Static_assert(offsetof(own, member) == offsetof(real, real_member), #real " " #real_member);                          \
  _Static_assert(sizeof(((own *)0)->member) == sizeof(((real *)0)->real_member), #real " " #real_member " size")
#define SIZE(own, real) _Static_assert(sizeof(own) == sizeof(real), #real)
#define VALUE(own, real) _Static_assert((own) == (real), #real)

SIZE(allocator, rcutils_allocator_t);
SAME(allocator, state, rcutils_allocator_t, state);
SIZE(serialized, rcl_serialized_message_t);
SAME(serialized, length, rcl_serialized_message_t, buffer_length);
SAME(serialized, memory, rcl_serialized_message_t, allocator);
SAME(struct qos, history, rmw_qos_profile_t, history);
SAME(struct qos, depth, rmw_qos_profile_t, depth);
SAME(struct qos, reliability, rmw_qos_profile_t, reliability);
SAME(struct qos, durability, rmw_qos_profile_t, durability);
SIZE(struct service_options, rcl_service_options_t);
SAME(struct service_options, memory, rcl_service_options_t, allocator);
SAME(struct service_type, identifier, rosidl_service_type_support_t, typesupport_identifier);
SAME(struct service_type, data, rosidl_service_type_support_t, data);
SAME(struct service_type, request, rosidl_service_type_support_t, request_typesupport);
SAME(struct service_type, response, rosidl_service_type_support_t, response_typesupport);
SIZE(struct endpoints, rcl_topic_endpoint_info_array_t);
SAME(struct endpoints, count, rcl_topic_endpoint_info_array_t, size);
SIZE(struct request_id, rmw_request_id_t);
SAME(struct request_id, number, rmw_request_id_t, sequence_number);
SIZE(struct request_info, rmw_service_info_t);
SAME(struct request_info, received, rmw_service_info_t, received_timestamp);
SAME(struct request_info, id, rmw_service_info_t, request_id);
/* Those that ROS writes into have room for it; on Humble, an identity has 24 bytes. */
_Static_assert(sizeof(struct identity) >= sizeof(rmw_gid_t), "rmw_gid_t");
_Static_assert(offsetof(struct identity, data) == offsetof(rmw_gid_t, data), "rmw_gid_t data");
_Static_assert(sizeof(struct message_info) >= sizeof(rmw_message_info_t), "rmw_message_info_t");
SAME(struct message_info, sent, rmw_message_info_t, source_timestamp);
SAME(struct message_info, number, rmw_message_info_t, publication_sequence_number);
_Static_assert(offsetof(struct message_info, writer) == offsetof(rmw_message_info_t, publisher_gid.data), "writer");
SIZE(struct wait_set, rcl_wait_set_t);
SAME(struct wait_set, guards, rcl_wait_set_t, guard_conditions);
SAME(struct wait_set, services, rcl_wait_set_t, services);
SAME(struct wait_set, service_count, rcl_wait_set_t, size_of_services);
SAME(struct wait_set, impl, rcl_wait_set_t, impl);
SIZE(struct goal_info, rcl_action_goal_info_t);
SAME(struct goal_info, seconds, rcl_action_goal_info_t, stamp.sec);
/* What the library knows of without a structure: a context, and the arguments, begin with a pointer; so does a server. */
_Static_assert(offsetof(rcl_context_t, global_arguments) == 0 && sizeof(rcl_arguments_t) == sizeof(void *), "rcl_context_t");
_Static_assert(offsetof(rcl_node_options_t, use_global_arguments) == sizeof(allocator), "rcl_node_options_t");
_Static_assert(offsetof(rcl_node_options_t, arguments) == sizeof(allocator) + sizeof(void *), "rcl_node_options_t");
_Static_assert(sizeof(rcl_service_t) == sizeof(void *), "rcl_service_t");

VALUE(BAD_ALLOC, RCL_RET_BAD_ALLOC);
VALUE(TAKE_FAILED, RCL_RET_SUBSCRIPTION_TAKE_FAILED);
VALUE(NO_RESPONSE, RCL_RET_CLIENT_TAKE_FAILED);
VALUE(NO_REQUEST, RCL_RET_SERVICE_TAKE_FAILED);
VALUE(TIMER_CANCELED, RCL_RET_TIMER_CANCELED);
VALUE(TIMED_OUT, RCL_RET_TIMEOUT);
VALUE(KEEP_LAST, RMW_QOS_POLICY_HISTORY_KEEP_LAST);
VALUE(TRANSIENT_LOCAL, RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL);
VALUE(UNNUMBERED, RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED);

int main(void)
{
  return 0;
}
