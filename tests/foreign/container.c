/* A stand-in for `component_container` of rclcpp_components, on rcl alone: several nodes in a process, one thread, and the
 * services of composition_interfaces. As there, a class is looked up in the ament index, its library is never unloaded, and
 * a node does not read the arguments of the process. There is no intra-process communication, and nodes have no services. */
#include "composable.h"

#include <composition_interfaces/srv/list_nodes.h>
#include <composition_interfaces/srv/load_node.h>
#include <composition_interfaces/srv/unload_node.h>
#include <dlfcn.h>
#include <rosidl_runtime_c/string_functions.h>
#include <string.h>

#define MOST 32

typedef composition_interfaces__srv__LoadNode_Request load_request;
typedef composition_interfaces__srv__LoadNode_Response load_response;

static struct composable *loaded[MOST], *stays;
static rcl_context_t context;
static const load_request *current;

static double number_of(const char *name, double otherwise)
{
  for (size_t each = 0; each < current->parameters.size; each++) {
    const rcl_interfaces__msg__Parameter *found = &current->parameters.data[each];
    if (strcmp(found->name.data, name) == 0)
      return found->value.type == 3 ? found->value.double_value : (double)found->value.integer_value;
  }
  return otherwise;
}

/* The library of a class, from the ament index: lines of "CLASS;LIBRARY". */
static const char *library_of(const char *package, const char *plugin, char *library, size_t size)
{
  char *prefixes = strdup(getenv("AMENT_PREFIX_PATH")), path[4096], line[4096];
  for (char *prefix = strtok(prefixes, ":"); prefix; prefix = strtok(NULL, ":")) {
    snprintf(path, sizeof path, "%s/share/ament_index/resource_index/rclcpp_components/%s", prefix, package);
    FILE *file = fopen(path, "r");
    if (!file)
      continue;
    while (fgets(line, sizeof line, file)) {
      char *separator = strchr(line, ';');
      if (!separator || strncmp(line, plugin, separator - line) != 0 || plugin[separator - line])
        continue;
      separator[strcspn(separator, "\n")] = '\0';
      snprintf(library, size, "%s/%s", prefix, separator + 1);
      return NULL;
    }
    return "Failed to find class with the requested plugin name.";
  }
  return "Could not find requested resource in ament index";
}

/* A node with the name, the namespace and the remappings of the request, and nothing of the process's arguments. */
static void init_node(rcl_node_t *node, const load_request *request)
{
  const char *words[2 * 64 + 5] = {"--ros-args"};
  static char name[300], namespace[300];
  int count = 1;
  for (size_t each = 0; each < request->remap_rules.size; each++) {
    words[count++] = "-r";
    words[count++] = request->remap_rules.data[each].data;
  }
  snprintf(name, sizeof name, "__node:=%s", request->node_name.data);
  snprintf(namespace, sizeof namespace, "__ns:=%s", request->node_namespace.data);
  for (int each = 0; each < 2; each++)
    if ((each ? request->node_namespace : request->node_name).size) {
      words[count++] = "-r";
      words[count++] = each ? namespace : name;
    }
  rcl_node_options_t options = rcl_node_get_default_options();
  options.use_global_arguments = false;
  require(rcl_parse_arguments(count, words, options.allocator, &options.arguments), "arguments");
  *node = rcl_get_zero_initialized_node();
  require(rcl_node_init(node, "component", "", &context, &options), "node");
}

static const char *load(const load_request *request, load_response *response)
{
  char library[4096];
  const char *fault = library_of(request->package_name.data, request->plugin_name.data, library, sizeof library);
  if (fault)
    return fault;
  void *opened = dlopen(library, RTLD_NOW);
  create_function *create = opened ? (create_function *)dlsym(opened, "create") : NULL;
  if (!create)
    return dlerror();
  size_t place = 0;
  while (place < MOST && loaded[place])
    place++;
  struct composable *made = calloc(1, sizeof *made);
  init_node(&made->node, request);
  current = request;
  if ((fault = create(made, request->plugin_name.data, number_of))) {
    require(rcl_node_fini(&made->node), "node");
    free(made);
    return fault;
  }
  made->slot = now() + made->period;
  loaded[place] = made;
  response->unique_id = place + 1;
  rosidl_runtime_c__String__assign(&response->full_node_name, rcl_node_get_fully_qualified_name(&made->node));
  return NULL;
}

static bool unload(uint64_t id)
{
  if (id < 1 || id > MOST || !loaded[id - 1])
    return false;
  if (!loaded[id - 1]->end(loaded[id - 1])) {
    stays = loaded[id - 1];
  } else {
    require(rcl_node_fini(&loaded[id - 1]->node), "node");
    free(loaded[id - 1]);
  }
  loaded[id - 1] = NULL;
  return true;
}

/* As rclcpp does it: whoever has asked may not wait any more. */
static void respond(const rcl_service_t *service, rmw_request_id_t *id, void *response)
{
  rcl_ret_t sent = rcl_send_response(service, id, response);
  if (sent != RCL_RET_TIMEOUT)
    require(sent, "response");
}

static void answer(rcl_service_t *loads, rcl_service_t *unloads, rcl_service_t *lists)
{
  rmw_request_id_t id;
  load_request to_load;
  composition_interfaces__srv__LoadNode_Request__init(&to_load);
  if (rcl_take_request(loads, &id, &to_load) == RCL_RET_OK) {
    load_response response;
    composition_interfaces__srv__LoadNode_Response__init(&response);
    const char *fault = load(&to_load, &response);
    response.success = !fault;
    rosidl_runtime_c__String__assign(&response.error_message, fault ? fault : "");
    respond(loads, &id, &response);
    composition_interfaces__srv__LoadNode_Response__fini(&response);
  }
  composition_interfaces__srv__LoadNode_Request__fini(&to_load);
  composition_interfaces__srv__UnloadNode_Request to_unload = {0};
  if (rcl_take_request(unloads, &id, &to_unload) == RCL_RET_OK) {
    composition_interfaces__srv__UnloadNode_Response response;
    composition_interfaces__srv__UnloadNode_Response__init(&response);
    response.success = unload(to_unload.unique_id);
    respond(unloads, &id, &response);
    composition_interfaces__srv__UnloadNode_Response__fini(&response);
    if (stays)
      stays->stay(stays);
  }
  composition_interfaces__srv__ListNodes_Request to_list = {0};
  if (rcl_take_request(lists, &id, &to_list) == RCL_RET_OK) {
    composition_interfaces__srv__ListNodes_Response response;
    composition_interfaces__srv__ListNodes_Response__init(&response);
    size_t count = 0;
    for (size_t each = 0; each < MOST; each++)
      count += loaded[each] != NULL;
    rosidl_runtime_c__String__Sequence__init(&response.full_node_names, count);
    rosidl_runtime_c__uint64__Sequence__init(&response.unique_ids, count);
    for (size_t each = 0, at = 0; each < MOST; each++)
      if (loaded[each]) {
        response.unique_ids.data[at] = each + 1;
        rosidl_runtime_c__String__assign(&response.full_node_names.data[at++],
                                         rcl_node_get_fully_qualified_name(&loaded[each]->node));
      }
    respond(lists, &id, &response);
    composition_interfaces__srv__ListNodes_Response__fini(&response);
  }
  if (rcl_error_is_set())
    rcl_reset_error(); /* what there was no request for */
}

int main(int count, char **arguments)
{
  rcl_node_t node;
  rcl_service_t services[3];
  rcl_service_options_t service_options = rcl_service_get_default_options();
  rcl_wait_set_t set = rcl_get_zero_initialized_wait_set();
  const rosidl_service_type_support_t *types[3] = {
      ROSIDL_GET_SRV_TYPE_SUPPORT(composition_interfaces, srv, LoadNode),
      ROSIDL_GET_SRV_TYPE_SUPPORT(composition_interfaces, srv, UnloadNode),
      ROSIDL_GET_SRV_TYPE_SUPPORT(composition_interfaces, srv, ListNodes)};
  const char *names[3] = {"~/_container/load_node", "~/_container/unload_node", "~/_container/list_nodes"};
  start_node(count, arguments, "ComponentManager", &context, &node);
  for (int each = 0; each < 3; each++) {
    services[each] = rcl_get_zero_initialized_service();
    require(rcl_service_init(&services[each], &node, types[each], names[each], &service_options), names[each]);
  }
  require(rcl_wait_set_init(&set, 0, 0, 0, 0, 3, 0, &context, rcl_get_default_allocator()), "wait set");
  for (;;) {
    long long next = now() + 1000000000;
    for (int each = 0; each < MOST; each++)
      if (loaded[each]) {
        if (now() >= loaded[each]->slot) {
          loaded[each]->tick(loaded[each]);
          loaded[each]->slot += loaded[each]->period;
        }
        if (loaded[each]->slot < next)
          next = loaded[each]->slot;
      }
    require(rcl_wait_set_clear(&set), "wait set");
    for (int each = 0; each < 3; each++)
      require(rcl_wait_set_add_service(&set, &services[each], NULL), "wait set");
    long long left = next - now();
    rcl_ret_t waited = rcl_wait(&set, left > 0 ? left : 0);
    if (waited == RCL_RET_OK)
      answer(&services[0], &services[1], &services[2]);
    else if (waited != RCL_RET_TIMEOUT)
      require(waited, "wait");
  }
}
