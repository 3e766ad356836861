/* The ROS nodes of this process. */
#include "gate.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Counted from here, so that a node is never taken for a port. */
#define NODE_NUMBER UINT32_MAX

#define LOAD_NODE "/_container/load_node"
static _Thread_local bool loading;

static bool loads(const char *service)
{
  size_t length = strlen(service), own = strlen(LOAD_NODE);
  return length > own && strcmp(service + length - own, LOAD_NODE) == 0;
}

void begin_loading(const char *service)
{
  if (loading || !loads(service))
    return;
  loading = true;
  atomic_fetch_add(&node->loads, 1);
}

void end_loading(const char *service)
{
  if (!loading || !loads(service))
    return;
  loading = false;
  atomic_fetch_sub(&node->loads, 1);
}

static unsigned own_number(void)
{
  return (unsigned)(node - page->nodes) + 1;
}

/* Whether a node of the page, by its index + 1, is one of this process. */
static bool is_inside(unsigned number)
{
  return number == own_number() || (number && number <= NODES && page->nodes[number - 1].process == own_number());
}

/* Which of the listed nodes has that full name; NULL where none has. With `lock`. */
static struct port *listed_node(const char *name)
{
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++) {
    struct port *port = &page->ports[index];
    if (atomic_load(&port->kind) == NODE && is_inside(atomic_load(&port->node)) && strncmp(port->topic, name, NAME) == 0)
      return port;
  }
  return NULL;
}

/* The node of the page with the full name of one of librcl, as index + 1; 0 where none has it. */
static unsigned named(const char *name)
{
  for (unsigned index = 0; index < NODES; index++) {
    struct node *other = &page->nodes[index];
    if (atomic_load(&other->used) && other->process == own_number() && other->name[0] &&
        strncmp(other->name, name, NAME) == 0)
      return index + 1;
  }
  return 0;
}

/* Whether the process has several nodes of the page. */
static bool is_shared(void)
{
  for (unsigned index = 0; index < NODES; index++)
    if (atomic_load(&page->nodes[index].used) && page->nodes[index].process == own_number() && page->nodes[index].name[0])
      return true;
  return false;
}

unsigned node_of(const void *owner)
{
  const char *name =
      is_shared() && real_rcl_node_get_fully_qualified_name() ? real_rcl_node_get_fully_qualified_name()(owner) : NULL;
  unsigned found = name ? named(name) : 0;
  struct port *port = name && !found ? listed_node(name) : NULL;
  return found ? found : port ? atomic_load(&port->node) : own_number();
}

unsigned being_loaded(void)
{
  unsigned loaded = loading ? atomic_load(&node->loading) : 0;
  return is_inside(loaded) ? loaded : 0;
}

/* To which node of the page one belongs that this thread creates, as index + 1. */
static unsigned owner_of(const char *name)
{
  unsigned found = named(name), loaded = being_loaded();
  return found ? found : loaded ? loaded : own_number();
}

/* List a node that the process has created: the manager asks for all that end with it. */
static void list_node(const void *created)
{
  const char *name = real_rcl_node_get_fully_qualified_name() ? real_rcl_node_get_fully_qualified_name()(created) : NULL;
  if (!name || strlen(name) >= NAME)
    return;
  pthread_mutex_lock(&lock);
  struct port *port = reserve_port(page, descriptor, owner_of(name));
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
  char *given = page && name && context && options ? given_name(name, context, options) : NULL;
  int result = real_rcl_node_init()(created, given ? given : name, namespace, context, options);
  free(given);
  if (page && result == 0)
    list_node(created);
  return result;
}

/* Give up a node of the page, by its index + 1, if nothing is left of it in this process, which goes on. With `lock`. */
static void give_up(unsigned me)
{
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++)
    if (atomic_load(&page->ports[index].kind) == NODE && atomic_load(&page->ports[index].node) == me)
      return;
  if (!forget_ports(me))
    return;
  forget_asked(me);
  atomic_store(&page->nodes[me - 1].pid, 0); /* first: it has not ended */
  struct flock released = lock_of(me, F_UNLCK);
  fcntl(descriptor, F_SETLK, &released);
}

/* A node of that full name has ended, which belonged to the node `owner` of the page (index + 1; 0: not known). The manager
 * may have freed that before. With `lock`. */
static void leave_ended(const char *name, unsigned owner)
{
  for (unsigned me = 1; me <= NODES; me++) {
    struct node *other = &page->nodes[me - 1];
    bool inside = me != own_number() && other->process == own_number();
    if (inside && atomic_load(&other->pid) == (uint32_t)getpid() &&
        (me == owner || !atomic_load(&other->used) || strncmp(other->name, name, NAME) == 0))
      give_up(me);
  }
}

EXPORT int rcl_node_fini(void *ended)
{
  const char *name =
      page && real_rcl_node_get_fully_qualified_name() ? real_rcl_node_get_fully_qualified_name()(ended) : NULL;
  if (page) {
    pthread_mutex_lock(&lock);
    remove_servers_of(ended); /* rclpy does not end its server of type descriptions */
    struct port *port = name ? listed_node(name) : NULL;
    unsigned owner = port ? atomic_load(&port->node) : 0;
    if (port)
      free_port(port);
    if (name)
      leave_ended(name, owner);
    pthread_mutex_unlock(&lock);
  }
  return real_rcl_node_fini()(ended);
}
