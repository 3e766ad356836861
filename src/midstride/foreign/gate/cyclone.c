/* Identities with rmw_cyclonedds_cpp, as every process sees them.
 *
 * There ROS names a publisher, the writer of a message and half of the client of a request by numbers that Cyclone DDS has
 * given in the own process. Two processes that hand over to each other have to name them alike. The other half of a client is
 * from its own process, and alike everywhere; for the rest, Cyclone DDS has the identity by which the graph shows an endpoint.
 * Its functions need the number of the entity, which is the first thing that the data of an rmw publisher or subscription has:
 * whether it is that is asked of Cyclone DDS each time. */
#include "gate.h"

#include <dlfcn.h>
#include <string.h>

/* rmw_publisher_t and rmw_subscription_t */
struct rmw_endpoint {
  const char *implementation;
  const void *data;
};

static struct {
  int32_t (*handle_of)(int32_t entity, uint64_t *handle);
  int32_t (*guid_of)(int32_t entity, uint8_t *guid);
  void *(*writer_of)(int32_t reader, uint64_t handle); /* begins with its identity */
  void (*free_writer)(void *found);
} cyclone;
static pthread_once_t looked_up = PTHREAD_ONCE_INIT;
static bool is_used;

static void look_up(void)
{
  const char *(*name)(void) = real_rmw_get_implementation_identifier();
  is_used = name && strcmp(name(), "rmw_cyclonedds_cpp") == 0;
  void *library = is_used ? dlopen("librmw_cyclonedds_cpp.so", RTLD_NOW | RTLD_NOLOAD) : NULL;
  if (!library) /* it stays loaded, as the functions are used from here on */
    return;
  *(void **)&cyclone.handle_of = dlsym(library, "dds_get_instance_handle");
  *(void **)&cyclone.guid_of = dlsym(library, "dds_get_guid");
  *(void **)&cyclone.writer_of = dlsym(library, "dds_get_matched_publication_data");
  *(void **)&cyclone.free_writer = dlsym(library, "dds_builtintopic_free_endpoint");
}

static bool uses_cyclone(void)
{
  pthread_once(&looked_up, look_up);
  return is_used;
}

static int32_t entity_of(const void *endpoint)
{
  int32_t entity = 0;
  const struct rmw_endpoint *known = endpoint;
  if (known && known->data)
    memcpy(&entity, known->data, sizeof entity);
  return entity;
}

bool graph_identity(const void *publisher, struct identity *identity)
{
  const void *endpoint = real_rcl_publisher_get_rmw_handle()(publisher);
  if (real_rmw_get_gid_for_publisher()(endpoint, identity) != 0) {
    if (real_rcutils_reset_error())
      real_rcutils_reset_error()();
    return false;
  }
  if (!uses_cyclone())
    return true;
  uint64_t named, handle;
  memcpy(&named, identity->data, sizeof named);
  int32_t entity = entity_of(endpoint);
  return cyclone.handle_of && cyclone.guid_of && cyclone.handle_of(entity, &handle) == 0 && handle == named &&
         cyclone.guid_of(entity, identity->data) == 0;
}

/* The last writer that this thread has looked up. */
static _Thread_local struct {
  const void *subscription;
  uint64_t handle;
  uint8_t writer[16];
} last;

void writer_identity(const void *subscription, const struct message_info *info, uint8_t writer[16])
{
  memcpy(writer, info->writer, sizeof info->writer);
  if (!uses_cyclone() || !real_rcl_subscription_get_rmw_handle())
    return;
  uint64_t handle;
  memcpy(&handle, info->writer, sizeof handle);
  if (last.subscription != subscription || last.handle != handle) {
    int32_t reader = entity_of(real_rcl_subscription_get_rmw_handle()(subscription));
    void *found = cyclone.writer_of && cyclone.free_writer ? cyclone.writer_of(reader, handle) : NULL;
    memset(last.writer, 0, sizeof last.writer); /* it has gone: as any other that has */
    if (found) {
      memcpy(last.writer, found, sizeof last.writer);
      cyclone.free_writer(found);
    }
    last.subscription = subscription;
    last.handle = handle;
  }
  memcpy(writer, last.writer, sizeof last.writer);
}

size_t client_length(const struct request_id *id)
{
  return uses_cyclone() ? sizeof id->client / 2 : sizeof id->client;
}
