/* The publishers, subscriptions and servers of this process that have a port in the page, by their address. */
#include "serving.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

struct table first_table;
struct used_port *used_ports;
unsigned used_count;

/* Of a port that no node of this process has any more. */
#define NOBODY UINT32_MAX

/* The entry that is looked for at `step`, from that of its hash on. */
static struct entry *probed(struct table *table, const void *endpoint, unsigned step)
{
  return &table->entries[((unsigned)(((uintptr_t)endpoint >> 4) * UINT32_C(2654435761)) + step) % ENTRIES];
}

struct entry *find_entry(const void *endpoint)
{
  if (!page)
    return NULL;
  for (struct table *table = &first_table; table; table = atomic_load_explicit(&table->next, memory_order_acquire))
    for (unsigned step = 0; step < ENTRIES; step++) {
      struct entry *entry = probed(table, endpoint, step);
      const void *known = atomic_load_explicit(&entry->endpoint, memory_order_acquire);
      if (known == endpoint)
        return entry;
      if (!known)
        return NULL; /* nor in the next table: this one has never been full */
    }
  return NULL;
}

/* An unused entry for `endpoint`; NULL where there is no memory for another table. With `lock`. */
static struct entry *unused(const void *endpoint)
{
  for (struct table *table = &first_table;; table = atomic_load(&table->next)) {
    for (unsigned step = 0; step < ENTRIES; step++) {
      struct entry *entry = probed(table, endpoint, step);
      const void *known = atomic_load(&entry->endpoint);
      if (!known || known == REMOVED)
        return entry;
    }
    if (!atomic_load(&table->next)) {
      struct table *added = calloc(1, sizeof *added);
      if (!added)
        return NULL;
      atomic_store_explicit(&table->next, added, memory_order_release);
    }
  }
}

/* Whether a node that lists its topics lists this one. rcl moves the publisher of /rosout after it has initialized it, so
 * nothing may be kept for its address. */
static bool listed(unsigned me, const char *topic)
{
  return page->nodes[me - 1].used & LISTS && strlen(topic) < NAME && strcmp(topic, "/rosout") != 0 &&
         strcmp(topic, "/parameter_events") != 0;
}

static bool ends_with(const char *text, const char *end)
{
  size_t length = strlen(text), own = strlen(end);
  return length >= own && strcmp(text + length - own, end) == 0;
}

/* Whether only one node of a role may write on this topic, which is no port: not where it says something of the process
 * itself, and not of ROS actions, whose goals stay with their server. */
static bool handed_over(unsigned me, const char *topic)
{
  return atomic_load(&page->nodes[me - 1].unstated) && strcmp(topic, "/rosout") != 0 &&
         strcmp(topic, "/parameter_events") != 0 && strcmp(topic, "/diagnostics") != 0 && !ends_with(topic, "/bond") &&
         !ends_with(topic, "/transition_event") && !strstr(topic, "/_action/");
}

/* The port of the node `me` with that topic; NULL where there is none. With `lock`. */
static struct port *port_of(unsigned me, const char *topic, uint32_t kind)
{
  uint32_t number = 0;
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++) {
    struct port *port = &page->ports[index];
    uint32_t found = atomic_load(&port->kind);
    if (atomic_load(&port->node) != me || found == NODE)
      continue;
    if (found == kind && strncmp(port->topic, topic, NAME) == 0)
      return port;
    number += found != SERVER;
  }
  bool shared = kind == OUTPUT && handed_over(me, topic);
  bool wanted = kind == SERVER ? strlen(topic) < NAME : listed(me, topic) || shared;
  struct port *port = wanted && strlen(topic) < NAME ? reserve_port(page, descriptor, me) : NULL;
  if (!port && shared)
    dprintf(STDERR_FILENO, "midstride: %s has no gate, since the page of the gates has no room for it: while this node is "
            "replaced, both instances write there\n", topic);
  if (port) {
    strcpy(port->topic, topic);
    port->number = number;
    port->gate = OPEN;
    if (shared) {
      port->flags = KEEPS | TIMED | OFFERS;
      port->baton = atomic_load(&page->nodes[me - 1].unstated);
    }
    port->kind = kind; /* last: the manager reads the rest where it is not UNUSED */
  }
  return port;
}

/* The index of a port among those that have been used; that many where there is no memory for one more. With `lock`. */
static unsigned use(struct port *port, unsigned me)
{
  unsigned index = 0, free = 0;
  while (index < used_count && (used_ports[index].port != port || used_ports[index].me != me))
    index++;
  while (free < used_count && used_ports[free].me != NOBODY)
    free++;
  if (index == used_count && free < used_count) {
    used_ports[free] = (struct used_port){.port = port, .me = me};
    return free;
  }
  if (index == used_count) {
    struct used_port *more = realloc(used_ports, (used_count + 1) * sizeof *used_ports);
    if (!more)
      return index;
    used_ports = more;
    used_ports[used_count++] = (struct used_port){.port = port, .me = me};
  }
  return index;
}

static enum service service_of(const char *name)
{
  static const char *const names[] = {[SEND_GOAL] = "/_action/send_goal",
                                      [CANCEL_GOAL] = "/_action/cancel_goal",
                                      [GET_RESULT] = "/_action/get_result"};
  size_t length = strlen(name);
  for (enum service each = SEND_GOAL; each <= GET_RESULT; each++)
    if (length > strlen(names[each]) && strcmp(name + length - strlen(names[each]), names[each]) == 0)
      return each;
  return OTHER;
}

bool add_entry(const void *endpoint, const void *owner, const char *topic, uint32_t kind, const void *type,
               const void *response)
{
  pthread_mutex_lock(&lock);
  unsigned me = node_of(owner);
  struct port *port = topic ? port_of(me, topic, kind) : NULL;
  struct entry *entry = port ? unused(endpoint) : NULL;
  unsigned used = entry ? use(port, me) : 0;
  if (!entry || used == used_count) {
    pthread_mutex_unlock(&lock);
    return !port;
  }
  struct node *own = &page->nodes[me - 1];
  if (atomic_load(&own->pid) != (uint32_t)getpid()) {
    struct flock held = lock_of(me, F_WRLCK);
    fcntl(descriptor, F_SETLK, &held);
    atomic_store(&own->pid, (uint32_t)getpid());
  }
  entry->port = port;
  entry->kind = kind;
  entry->me = me;
  entry->used = used;
  entry->type = type;
  entry->overdue = false;
  entry->kept = NULL;
  entry->kept_end = &entry->kept;
  entry->keeping = 0;
  entry->kept_bytes = 0;
  bool known = kind == OUTPUT && real_rcl_publisher_get_actual_qos();
  const struct qos *qos = known ? real_rcl_publisher_get_actual_qos()(endpoint) : NULL;
  entry->most_kept = kind == OUTPUT ? most_kept(qos) : 0;
  entry->latched = is_latched(qos);
  entry->key = key_of(topic, strlen(topic));
  atomic_store(&entry->receipts, NULL);
  memset((void *)entry->outputs, 0, sizeof entry->outputs);
  atomic_store(&entry->open, 0);
  entry->owner = owner;
  entry->held = NULL;
  entry->end = &entry->held;
  entry->callback = NULL;
  entry->service = kind == SERVER ? service_of(topic) : OTHER;
  entry->response = response;
  entry->taken = NULL;
  entry->cancelled = false;
  memset(entry->unanswered, 0, sizeof entry->unanswered);
  atomic_store(&entry->responses, atomic_load(&port->answered));
  atomic_store(&entry->holding, 0);
  atomic_store_explicit(&entry->endpoint, endpoint, memory_order_release);
  atomic_fetch_add(&port->endpoints, 1);
  keep_helping();
  pthread_mutex_unlock(&lock);
  return true;
}

bool forget_ports(unsigned me)
{
  for (struct table *table = &first_table; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++) {
      const void *known = atomic_load(&table->entries[index].endpoint);
      if (known && known != REMOVED && table->entries[index].me == me)
        return false;
    }
  for (unsigned index = 0; index < used_count; index++)
    if (used_ports[index].me == me)
      used_ports[index].me = NOBODY;
  return true;
}

/* With `lock`. */
static void removed(struct entry *entry)
{
  atomic_store_explicit(&entry->endpoint, REMOVED, memory_order_release);
  if (atomic_load(&entry->port->node) == entry->me) { /* the manager has not freed it */
    atomic_fetch_sub(&entry->port->endpoints, 1);
    atomic_store(&entry->port->waiting, 0);
    atomic_store(&entry->port->busy, 0);
  }
  discard_kept(entry, 0);
  drop_requests(entry);
}

void remove_entry(const void *endpoint)
{
  struct entry *entry = find_entry(endpoint);
  if (!entry)
    return;
  pthread_mutex_lock(&lock);
  removed(entry);
  pthread_mutex_unlock(&lock);
}

void remove_servers_of(const void *owner)
{
  for (struct table *table = &first_table; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++) {
      struct entry *entry = &table->entries[index];
      const void *known = atomic_load(&entry->endpoint);
      if (known && known != REMOVED && entry->kind == SERVER && entry->owner == owner)
        removed(entry);
    }
}
