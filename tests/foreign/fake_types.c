/* In the place of a library of service types, as rosidl_typesupport_c generates them: that of `fakes/srv/Fake`. The type ends
 * as on Humble, without those of its messages; ROS's own generators make the same names. */
#include <stddef.h>

static const char *const identifiers[] = {"rosidl_typesupport_fakes_c"};
static const char *const symbols[] = {"rosidl_typesupport_fakes_c__get_service_type_support_handle__fakes__srv__Fake"};
static void *libraries[1];
static const struct {
  size_t count;
  const char *package;
  const char *const *identifiers, *const *symbols;
  void **libraries;
} map = {1, "fakes", identifiers, symbols, libraries};
static const void *const type[] = {"rosidl_typesupport_c", &map, NULL};

const void *rosidl_typesupport_c__get_service_type_support_handle__fakes__srv__Fake(void)
{
  return type;
}

const void *rosidl_typesupport_c__get_message_type_support_handle__fakes__srv__Fake_Request(void)
{
  return "request";
}

const void *rosidl_typesupport_c__get_message_type_support_handle__fakes__srv__Fake_Response(void)
{
  return "response";
}
