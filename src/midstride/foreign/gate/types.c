/* What Humble does not tell of a service, and later distributions do: the types of its messages, and its clients.
 *
 * There the type of a service has those of its requests and responses only in the form of each middleware. But it knows the
 * functions by which the middlewares get them, by name; the message types have such functions of nearly the same names.
 */
#define _GNU_SOURCE
#include "serving.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

/* type_support_map_t, of rosidl_typesupport_c and rosidl_typesupport_cpp alike. */
struct type_map {
  size_t count;
  const char *package;
  const char *const *identifiers;
  const char *const *symbols; /* MIDDLEWARE__get_service_type_support_handle__PACKAGE__srv__NAME */
  void **libraries;
};
#define OF_SERVICE "__get_service_type_support_handle__"
#define OF_MESSAGE "__get_message_type_support_handle__"

/* The type of a message whose name is that of its service, and a suffix. `library`: which has the type of the service. */
static const void *named_type(void *library, const char *typesupport, const char *service, const char *suffix)
{
  char name[512];
  int length = snprintf(name, sizeof name, "%s" OF_MESSAGE "%s%s", typesupport, service, suffix);
  void *found = length > 0 && (size_t)length < sizeof name ? dlsym(library, name) : NULL;
  return found ? ((const void *(*)(void))found)() : NULL;
}

/* Exported for the test that compares it with what later distributions tell. */
EXPORT void midstride_named_types(const struct service_type *type, const void **request, const void **response)
{
  *request = *response = NULL;
  bool generated = type->identifier && (strcmp(type->identifier, "rosidl_typesupport_c") == 0 ||
                                        strcmp(type->identifier, "rosidl_typesupport_cpp") == 0);
  const struct type_map *map = generated ? type->data : NULL;
  const char *symbol = map && map->count ? strstr(map->symbols[0], OF_SERVICE) : NULL;
  Dl_info where;
  if (!symbol || !dladdr(type, &where) || !where.dli_fname)
    return;
  void *library = dlopen(where.dli_fname, RTLD_NOW | RTLD_NOLOAD);
  if (!library)
    return;
  const char *service = symbol + strlen(OF_SERVICE);
  *request = named_type(library, type->identifier, service, "_Request");
  *response = named_type(library, type->identifier, service, "_Response");
  dlclose(library);
}

struct message_types message_types(const struct service_type *type)
{
  struct message_types found = {NULL, NULL};
  if (real_rcl_service_configure_service_introspection()) { /* from Iron on, as the types are in that of the service */
    found.request = type->request;
    found.response = type->response;
  } else {
    midstride_named_types(type, &found.request, &found.response);
  }
  return found;
}

/* Without rcl_count_clients: the writers of its requests, as implementations over DDS name their topic. */
static size_t writers_of(const void *owner, const char *topic)
{
  char name[NAME + sizeof "rqRequest"];
  struct endpoints found = {0, NULL};
  int length = snprintf(name, sizeof name, "rq%sRequest", topic);
  if (!real_rcl_get_publishers_info_by_topic() || !real_rmw_topic_endpoint_info_array_fini() || length < 0 ||
      (size_t)length >= sizeof name)
    return 0;
  bool asked = real_rcl_get_publishers_info_by_topic()(owner, &heap, name, true, &found) == 0;
  size_t count = asked ? found.count : 0;
  bool freed = asked && real_rmw_topic_endpoint_info_array_fini()(&found, &heap) == 0;
  if (!freed)
    real_rcutils_reset_error()();
  return count;
}

size_t clients_of(const void *owner, const char *topic)
{
  size_t count = 0;
  if (!real_rcl_count_clients())
    return writers_of(owner, topic);
  if (real_rcl_count_clients()(owner, topic, &count) == 0)
    return count;
  real_rcutils_reset_error()();
  return 0;
}
