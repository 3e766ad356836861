/* The ROS nodes of this process, and their names. */
#include "gate.h"

#include <string.h>

/* Counted from here, so that a node is never taken for a port. */
#define NODE_NUMBER UINT32_MAX

/* Which of the listed nodes has that full name; NULL where none has. With `lock`. */
static struct port *listed_node(const char *name)
{
  unsigned own = (unsigned)(node - page->nodes) + 1;
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++) {
    struct port *port = &page->ports[index];
    if (atomic_load(&port->node) == own && atomic_load(&port->kind) == NODE && strncmp(port->topic, name, NAME) == 0)
      return port;
  }
  return NULL;
}

/* List a node that the process has created: the manager asks for all that end with it. */
static void list_node(const void *created)
{
  const char *name = real_rcl_node_get_fully_qualified_name() ? real_rcl_node_get_fully_qualified_name()(created) : NULL;
  if (!name || strlen(name) >= NAME)
    return;
  pthread_mutex_lock(&lock);
  struct port *port = claim_port(page, descriptor, (unsigned)(node - page->nodes) + 1);
  if (port) {
    strcpy(port->topic, name);
    port->number = NODE_NUMBER;
    atomic_store(&port->kind, NODE);
  } else {
    atomic_fetch_add(&node->unlisted, 1);
  }
  pthread_mutex_unlock(&lock);
}

EXPORT int rcl_node_init(void *created, const char *name, const char *namespace, void *context, const void *options)
{
  int result = real_rcl_node_init()(created, name, namespace, context, options);
  if (page && result == 0)
    list_node(created);
  return result;
}

EXPORT int rcl_node_fini(void *ended)
{
  const char *name =
      page && real_rcl_node_get_fully_qualified_name() ? real_rcl_node_get_fully_qualified_name()(ended) : NULL;
  if (name) {
    pthread_mutex_lock(&lock);
    struct port *port = listed_node(name);
    if (port)
      free_port(port);
    pthread_mutex_unlock(&lock);
  }
  return real_rcl_node_fini()(ended);
}

/* The rules of the command line name the node as which the process was started, which is the first one that has no name of
 * its own from its program's rules (`local`); further nodes keep theirs. */
EXPORT int rcl_remap_node_name(const void *local, const void *global, const char *name, allocator memory, char **remapped)
{
  static char first_name[NAME];
  if (!page || !global || !(node->used & NAMES_ONE) || strlen(name) >= NAME)
    return real_rcl_remap_node_name()(local, global, name, memory, remapped);
  /* rcl refuses to look where there are no rules at all, which is so of most programs in C: `impl` is NULL. */
  *remapped = NULL;
  if (local && *(void *const *)local) {
    int result = real_rcl_remap_node_name()(local, NULL, name, memory, remapped);
    if (result != 0 || *remapped)
      return result;
  }
  pthread_mutex_lock(&lock);
  if (!first_name[0])
    strcpy(first_name, name);
  bool own = strcmp(first_name, name) == 0;
  pthread_mutex_unlock(&lock);
  return own ? real_rcl_remap_node_name()(local, global, name, memory, remapped) : 0;
}
