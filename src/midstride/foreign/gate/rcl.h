/* The C interface of ROS, as far as the library uses it. No header of ROS is needed: what differs from Humble to Lyrical is
 * said where it is (docs/reference/distributions.md).
 *
 * `real_NAME()` is the function NAME of ROS, found when it is first called; NULL where no library of the process has it.
 */
#ifndef MIDSTRIDE_RCL_H
#define MIDSTRIDE_RCL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct goal_info; /* in page.h */

/* RCL_RET_BAD_ALLOC */
#define BAD_ALLOC 10
/* RCL_RET_SUBSCRIPTION_TAKE_FAILED: there was no message. */
#define TAKE_FAILED 401
/* RCL_RET_CLIENT_TAKE_FAILED: there was no response. */
#define NO_RESPONSE 501
/* RCL_RET_SERVICE_TAKE_FAILED: there was no request. */
#define NO_REQUEST 601
/* RCL_RET_TIMER_CANCELED: it is not called. */
#define TIMER_CANCELED 801
/* RCL_RET_TIMEOUT */
#define TIMED_OUT 2

typedef struct {
  void *(*allocate)(size_t, void *);
  void (*deallocate)(void *, void *);
  void *(*reallocate)(void *, size_t, void *);
  void *(*zero_allocate)(size_t, size_t, void *);
  void *state;
} allocator;

/* rcl_serialized_message_t */
typedef struct {
  uint8_t *buffer;
  size_t length;
  size_t capacity;
  allocator memory;
} serialized;

/* What is of interest of rmw_qos_profile_t. */
struct qos {
  int history;
  size_t depth;
  int reliability;
  int durability;
};
/* RMW_QOS_POLICY_HISTORY_KEEP_LAST, RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL */
#define KEEP_LAST 1
#define TRANSIENT_LOCAL 1

/* rcl_service_options_t: of its QoS profile, only the queue is of interest here. */
struct service_options {
  int history;
  size_t depth;
  uint64_t rest[9];
  allocator memory;
};

/* rosidl_service_type_support_t: up to Humble, it ends after the first three. */
struct service_type {
  const char *identifier;
  const void *data;
  const void *function;
  const void *request;
  const void *response;
};

/* rmw_topic_endpoint_info_array_t */
struct endpoints {
  size_t count;
  void *each;
};

/* rmw_request_id_t */
struct request_id {
  uint8_t client[16];
  int64_t number;
};

/* rmw_gid_t: up to Humble, the identity itself has 24 bytes. */
struct identity {
  const char *implementation;
  uint8_t data[24];
};

/* rmw_service_info_t */
struct request_info {
  int64_t sent;
  int64_t received;
  struct request_id id;
};

/* rmw_message_info_t. Up to Humble, an identity has 24 bytes; what follows it is not of interest. */
struct message_info {
  int64_t sent;
  int64_t received;
  uint64_t number; /* at its writer; UNNUMBERED: the middleware does not say */
  uint64_t reception;
  const char *implementation;
  uint8_t writer[16];
  uint8_t rest[64];
};
/* RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED */
#define UNNUMBERED UINT64_MAX

/* rcl_wait_set_t */
struct wait_set {
  const void **subscriptions;
  size_t subscription_count;
  const void **guards;
  size_t guard_count;
  const void **timers;
  size_t timer_count;
  const void **clients;
  size_t client_count;
  const void **services;
  size_t service_count;
  const void **events;
  size_t event_count;
  void *impl;
};

/* What the library itself copies, it has from malloc. */
extern const allocator heap;

#ifndef REAL_CALLED /* that of rcl.c defines them */
#define REAL_CALLED(result, name, symbol, ...) result (*real_##name(void))(__VA_ARGS__);
#endif
#define REAL(result, name, ...) REAL_CALLED(result, name, #name, __VA_ARGS__)
REAL(int, rcl_init, int, const char *const *, const void *, void *)
REAL(int, rcl_node_init, void *, const char *, const char *, void *, const void *)
REAL(int, rcl_node_fini, void *)
REAL(int, rcl_remap_node_name, const void *, const void *, const char *, allocator, char **)
REAL(const char *, rcl_node_get_fully_qualified_name, const void *)
REAL(int, rcl_publisher_init, void *, const void *, const void *, const char *, const void *)
REAL(int, rcl_publisher_fini, void *, void *)
REAL(const char *, rcl_publisher_get_topic_name, const void *)
REAL(const struct qos *, rcl_publisher_get_actual_qos, const void *)
REAL(const void *, rcl_publisher_get_rmw_handle, const void *)
REAL(int, rmw_get_gid_for_publisher, const void *, struct identity *)
REAL(const char *, rmw_get_implementation_identifier, void)
REAL(int, rcl_publisher_get_subscription_count, const void *, size_t *)
REAL(int, rcl_publish, const void *, const void *, void *)
REAL(int, rcl_publish_serialized_message, const void *, const void *, void *)
REAL(int, rcl_publish_loaned_message, const void *, void *, void *)
REAL(int, rcl_return_loaned_message_from_publisher, const void *, void *)
REAL(int, rcl_subscription_init, void *, const void *, const void *, const char *, const void *)
REAL(int, rcl_subscription_fini, void *, void *)
REAL(const char *, rcl_subscription_get_topic_name, const void *)
REAL(const void *, rcl_subscription_get_rmw_handle, const void *)
REAL(int, rcl_subscription_get_publisher_count, const void *, size_t *)
REAL(int, rcl_take, const void *, void *, struct message_info *, void *)
REAL(int, rcl_take_sequence, const void *, size_t, void *, void *, void *)
REAL(int, rcl_take_serialized_message, const void *, void *, struct message_info *, void *)
REAL(int, rcl_take_loaned_message, const void *, void **, struct message_info *, void *)
REAL(int, rcl_return_loaned_message_from_subscription, const void *, void *)
REAL(int, rcl_service_init, void *, const void *, const void *, const char *, const void *)
REAL(int, rcl_service_fini, void *, void *)
REAL(int, rcl_node_type_description_service_init, void *, const void *)
REAL(int, rcl_node_type_description_service_fini, void *)
REAL(const char *, rcl_service_get_service_name, const void *)
REAL(void *, rcl_service_configure_service_introspection, void)
REAL(int, rcl_service_set_on_new_request_callback, const void *, const void *, const void *)
REAL(int, rcl_count_clients, const void *, const char *, size_t *)
REAL(int, rcl_get_publishers_info_by_topic, const void *, const allocator *, const char *, bool, struct endpoints *)
REAL(int, rmw_topic_endpoint_info_array_fini, struct endpoints *, const allocator *)
REAL(int, rcl_take_request_with_info, const void *, struct request_info *, void *)
REAL(int, rcl_send_response, const void *, struct request_id *, void *)
REAL(int, rcl_action_update_goal_state, void *, int)
REAL(int, rcl_action_goal_handle_get_info, const void *, struct goal_info *)
REAL(int, rcl_action_expire_goals, const void *, struct goal_info *, size_t, size_t *)
REAL(int, rcl_client_init, void *, const void *, const void *, const char *, const void *)
REAL(int, rcl_client_fini, void *, void *)
REAL(int, rcl_take_response, const void *, struct request_id *, void *)
REAL(int, rcl_take_response_with_info, const void *, struct request_info *, void *)
REAL(int, rcl_timer_init, void *, void *, void *, int64_t, void *, allocator)
REAL(int, rcl_timer_init2, void *, void *, void *, int64_t, void *, allocator, bool)
REAL(int, rcl_timer_fini, void *)
REAL(void *, rcl_timer_exchange_callback, void *, void *)
REAL(int, rcl_timer_call, void *)
REAL(int, rcl_timer_call_with_info, void *, void *)
REAL(int, rcl_wait, struct wait_set *, int64_t)
REAL(int, rcl_trigger_guard_condition, const void *)
REAL(int, rmw_serialize, const void *, const void *, void *)
REAL(int, rmw_deserialize, const void *, const void *, void *)
REAL(void, rcutils_reset_error, void)
REAL(void, ros_trace_callback_start, const void *, bool)
REAL(void, ros_trace_callback_end, const void *)
REAL(void, ros_trace_rclcpp_intra_publish, const void *, const void *)
/* The type of the service by which a node describes the types of its topics. */
REAL_CALLED(const struct service_type *, type_description,
            "rosidl_typesupport_c__get_service_type_support_handle__type_description_interfaces__srv__GetTypeDescription",
            void)
/* Of rclcpp: member functions of PublisherBase, and IntraProcessManager::remove_publisher. */
#define SETUP_INTRA_PROCESS                                                                                              \
  "_ZN6rclcpp13PublisherBase19setup_intra_processEmSt10shared_ptrINS_12experimental19IntraProcessManagerEE"
REAL_CALLED(void, setup_intra_process, SETUP_INTRA_PROCESS, void *, uint64_t, void **)
/* From Lyrical on: with `const std::shared_ptr<…> &`. */
#define SETUP_BY_REFERENCE                                                                                               \
  "_ZN6rclcpp13PublisherBase19setup_intra_processEmRKSt10shared_ptrINS_12experimental19IntraProcessManagerEE"
REAL_CALLED(void, setup_by_reference, SETUP_BY_REFERENCE, void *, uint64_t, void **)
REAL_CALLED(const char *, publisher_get_topic_name, "_ZNK6rclcpp13PublisherBase14get_topic_nameEv", const void *)
REAL_CALLED(void, remove_publisher, "_ZN6rclcpp12experimental19IntraProcessManager16remove_publisherEm", void *, uint64_t)

#endif
