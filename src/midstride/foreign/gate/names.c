/* The name from the command line, for one node of this process alone.
 *
 * `-r __node:=NAME` names all nodes. Here it names the one as which the process was started: the first one that no other rule
 * names; further nodes keep their names. librcl applies the rules within rcl_node_init, by a call that this library does not
 * see where librcl is linked with -Bsymbolic-functions, as packages for Ubuntu are. So the rule is changed where a program
 * passes it to librcl: to one for a node of a name that none has. That node is then created as NAME.
 */
#include "gate.h"

#include <stdlib.h>
#include <string.h>

#define FIRST_NODE "midstride_first_node"

/* The begin of rcl_node_options_t. */
struct node_options {
  allocator memory;
  bool use_global_arguments;
  void *arguments; /* rcl_arguments_t: NULL where there are none */
};

/* Whether a rule names all nodes; rcl knows it by two names. */
static bool names_all(const char *rule)
{
  return strncmp(rule, "__node:=", 8) == 0 || strncmp(rule, "__name:=", 8) == 0;
}

static char *for_first_node(const char *rule)
{
  size_t length = strlen(rule), prefix = strlen(FIRST_NODE ":");
  char *changed = malloc(prefix + length + 1);
  if (changed) {
    memcpy(changed, FIRST_NODE ":", prefix);
    memcpy(changed + prefix, rule, length + 1);
  }
  return changed;
}

/* As many arguments, each at its place: programs look up by their places which ones rcl does not know. */
EXPORT int rcl_init(int count, const char *const *arguments, const void *options, void *context)
{
  bool names_one = page && node->used & NAMES_ONE && count > 0 && arguments;
  const char **own = names_one ? calloc((size_t)count, sizeof *own) : NULL;
  if (!own)
    return real_rcl_init()(count, arguments, options, context);
  bool for_ros = false, is_rule = false;
  for (int index = 0; index < count; index++) {
    const char *argument = own[index] = arguments[index];
    if (!argument)
      continue; /* rcl refuses it */
    char *changed = for_ros && is_rule && names_all(argument) ? for_first_node(argument) : NULL;
    if (changed)
      own[index] = changed;
    is_rule = strcmp(argument, "-r") == 0 || strcmp(argument, "--remap") == 0;
    for_ros = strcmp(argument, "--ros-args") == 0 || (for_ros && strcmp(argument, "--") != 0);
  }
  int result = real_rcl_init()(count, own, options, context);
  for (int index = 0; index < count; index++)
    if (own[index] != arguments[index])
      free((void *)own[index]);
  free(own);
  return result;
}

/* The name that rules give a node; NULL: none does. rcl_arguments_t is a pointer, and rcl refuses to look where none has
 * any. */
static char *renamed(const void *local, const void *global, const char *name)
{
  char *found = NULL;
  bool has_rules = (local && *(void *const *)local) || *(void *const *)global;
  if (has_rules && real_rcl_remap_node_name() && real_rcl_remap_node_name()(local, global, name, heap, &found) != 0) {
    if (real_rcutils_reset_error())
      real_rcutils_reset_error()();
    return NULL; /* so that rcl_node_init reports it */
  }
  return found;
}

char *given_name(const char *name, const void *context, const void *options)
{
  static char first_name[NAME];
  const struct node_options *stated = options;
  if (!(node->used & NAMES_ONE) || !stated->use_global_arguments || strlen(name) >= NAME)
    return NULL;
  const void *global = context; /* rcl_context_t begins with the rules of the command line */
  char *own = renamed(&stated->arguments, global, name);
  char *given = own ? NULL : renamed(NULL, global, FIRST_NODE);
  free(own);
  if (!given)
    return NULL;
  pthread_mutex_lock(&lock);
  if (!first_name[0])
    strcpy(first_name, name);
  bool is_first = strcmp(first_name, name) == 0;
  pthread_mutex_unlock(&lock);
  if (is_first)
    return given;
  free(given);
  return NULL;
}
