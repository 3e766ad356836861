// Makes the middleware of a process answer as rmw_zenoh does (ros2/rmw_zenoh, release 0.2.10), for LD_PRELOAD: other
// identifier, identities that say nothing of the process, acknowledgements that nobody has given, and no topics of
// services. Messages travel as before.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <rmw/rmw.h>
#include <rmw/get_topic_endpoint_info.h>

#define NEXT(name) (*(__typeof__(name) *)next(#name))

// By the name of its library, as what Python has loaded is not in the scope of a library that was preloaded.
static void *next(const char *name) {
  void *real = dlopen("librmw_fastrtps_cpp.so", RTLD_LAZY | RTLD_NOLOAD);
  void *found = real == NULL ? NULL : dlsym(real, name);
  if (found == NULL) abort();
  return found;
}

// One to one, so that the identities stay different; no bytes of the result are those of the process.
static void hash(uint8_t *gid) {
  uint64_t half[2];
  memcpy(half, gid, sizeof half);
  for (int round = 0; round < 4; round++) {
    uint64_t mixed = (half[1] + (uint64_t)round) * 0x9e3779b97f4a7c15u;
    mixed ^= mixed >> 29;
    mixed *= 0xbf58476d1ce4e5b9u;
    half[0] ^= mixed ^ (mixed >> 32);
    uint64_t swapped = half[0];
    half[0] = half[1];
    half[1] = swapped;
  }
  memcpy(gid, half, sizeof half);
}

const char *rmw_get_implementation_identifier(void) { return "rmw_zenoh_cpp"; }

rmw_ret_t rmw_publisher_wait_for_all_acked(const rmw_publisher_t *publisher, rmw_time_t timeout) {
  (void)publisher;
  (void)timeout;
  return RMW_RET_OK;
}

rmw_ret_t rmw_get_gid_for_publisher(const rmw_publisher_t *publisher, rmw_gid_t *gid) {
  rmw_ret_t result = NEXT(rmw_get_gid_for_publisher)(publisher, gid);
  if (result == RMW_RET_OK) hash(gid->data);
  return result;
}

static void all(rmw_topic_endpoint_info_array_t *infos) {
  for (size_t each = 0; each < infos->size; each++) hash(infos->info_array[each].endpoint_gid);
}

rmw_ret_t rmw_get_publishers_info_by_topic(const rmw_node_t *node, rcutils_allocator_t *allocator, const char *topic,
                                           bool no_mangle, rmw_topic_endpoint_info_array_t *infos) {
  if (no_mangle) return RMW_RET_OK;
  rmw_ret_t result = NEXT(rmw_get_publishers_info_by_topic)(node, allocator, topic, no_mangle, infos);
  if (result == RMW_RET_OK) all(infos);
  return result;
}

rmw_ret_t rmw_get_subscriptions_info_by_topic(const rmw_node_t *node, rcutils_allocator_t *allocator,
                                              const char *topic, bool no_mangle,
                                              rmw_topic_endpoint_info_array_t *infos) {
  if (no_mangle) return RMW_RET_OK;
  rmw_ret_t result = NEXT(rmw_get_subscriptions_info_by_topic)(node, allocator, topic, no_mangle, infos);
  if (result == RMW_RET_OK) all(infos);
  return result;
}

rmw_ret_t rmw_take_with_info(const rmw_subscription_t *subscription, void *message, bool *taken,
                             rmw_message_info_t *info, rmw_subscription_allocation_t *allocation) {
  rmw_ret_t result = NEXT(rmw_take_with_info)(subscription, message, taken, info, allocation);
  if (result == RMW_RET_OK && *taken) hash(info->publisher_gid.data);
  return result;
}

rmw_ret_t rmw_take_serialized_message_with_info(const rmw_subscription_t *subscription,
                                                rmw_serialized_message_t *message, bool *taken,
                                                rmw_message_info_t *info, rmw_subscription_allocation_t *allocation) {
  rmw_ret_t result = NEXT(rmw_take_serialized_message_with_info)(subscription, message, taken, info, allocation);
  if (result == RMW_RET_OK && *taken) hash(info->publisher_gid.data);
  return result;
}
