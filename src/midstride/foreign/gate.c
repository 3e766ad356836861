/* The gate inside a node that does not use Midstride's API, for LD_PRELOAD.
 *
 * Wraps the functions of librcl that create, publish and take; the environment names the page of shared memory and the
 * index of the node in it as which the process was started. Further nodes of the process are known by their names. Without
 * a page, and for every topic that is not in it, each function does what librcl does.
 * No header of ROS is needed: the types below are those of its C interface, which has not changed from Humble to Kilted.
 *
 * The manager loads this library, too, for its own steps with the baton (midstride_*, called by page.py).
 */
#define _GNU_SOURCE
#include "page.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/futex.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
#define ENV_PAGE "MIDSTRIDE_GATE_PAGE"
#define ENV_NODE "MIDSTRIDE_GATE_NODE"
/* How often the helper thread looks without being rung for (ns). */
#define LOOK 100000000L
/* RCL_RET_BAD_ALLOC */
#define BAD_ALLOC 10
/* RCL_RET_SUBSCRIPTION_TAKE_FAILED: there was no message. */
#define TAKE_FAILED 401
/* RCL_RET_SERVICE_TAKE_FAILED: there was no request. */
#define NO_REQUEST 601
/* RCL_RET_TIMEOUT */
#define TIMED_OUT 2
/* For how long a request is held that no node has claimed (ns), and how many of a service are held. */
#define HOLD INT64_C(5000000000)
#define MOST_HELD 1000u
/* After how long the node that answered before answers a request that its successor has not received (ns). */
#define LEFT_OVER INT64_C(300000000)
/* How long the node that answers a request to cancel many goals waits for the list of the other one (ns). */
#define ADDING INT64_C(1000000000)
/* How long a wait without a guard condition, which cannot be ended, lasts while requests are held (ns). */
#define SHORT_WAIT INT64_C(10000000)
/* Whose requests those of the manager to this node alone seem to be. */
#define MANAGER "midstride asks"
/* How many bytes the name of a file of one of them has more than that of the page. */
#define SUFFIX 64
#define FILE_NAME (PATH_MAX + SUFFIX)
/* How many requests a server's queue has room for at least. Of a shallower one, requests fall out while a busy executor
 * does not take them, as while a node starts. */
#define QUEUE 200u

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
/* How many messages of a publisher are kept at most that were written behind the gate. */
#define MOST_KEPT 1000u

/* rcl_service_options_t, up to Kilted: of its QoS profile, only the queue is of interest here. */
struct service_options {
  int history;
  size_t depth;
  uint64_t rest[9];
  allocator memory;
};

/* rosidl_service_type_support_t, from Iron on. */
struct service_type {
  const char *identifier;
  const void *data;
  const void *function;
  const void *request;
  const void *response;
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

/* The real functions, each found when it is first called: librcl may be loaded after this library. */
static void *real(_Atomic(void *) *known, const char *name)
{
  void *found = atomic_load_explicit(known, memory_order_acquire);
  if (found)
    return found;
  found = dlsym(RTLD_NEXT, name);
  /* Else loaded by an extension module of Python, so not in the global scope. What it is linked with is searched, too: the
   * functions of the middleware are in a library of another name on each installation. */
  static const char *const libraries[] = {"librcl.so", "librcl_action.so"};
  for (unsigned index = 0; !found && index < 2; index++) {
    void *handle = dlopen(libraries[index], RTLD_NOW | RTLD_NOLOAD);
    if (handle) {
      found = dlsym(handle, name);
      dlclose(handle);
    }
  }
  if (found)
    atomic_store_explicit(known, found, memory_order_release);
  return found;
}

#define REAL(result, name, ...)                                                                                          \
  static result (*real_##name(void))(__VA_ARGS__)                                                                        \
  {                                                                                                                      \
    static _Atomic(void *) known;                                                                                        \
    return (result(*)(__VA_ARGS__))real(&known, #name);                                                                  \
  }

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
REAL(int, rcl_publisher_get_subscription_count, const void *, size_t *)
REAL(int, rcl_publish, const void *, const void *, void *)
REAL(int, rcl_publish_serialized_message, const void *, const void *, void *)
REAL(int, rcl_publish_loaned_message, const void *, void *, void *)
REAL(int, rcl_return_loaned_message_from_publisher, const void *, void *)
REAL(int, rcl_subscription_init, void *, const void *, const void *, const char *, const void *)
REAL(int, rcl_subscription_fini, void *, void *)
REAL(const char *, rcl_subscription_get_topic_name, const void *)
REAL(int, rcl_subscription_get_publisher_count, const void *, size_t *)
REAL(int, rcl_take, const void *, void *, void *, void *)
REAL(int, rcl_take_sequence, const void *, size_t, void *, void *, void *)
REAL(int, rcl_take_serialized_message, const void *, void *, void *, void *)
REAL(int, rcl_take_loaned_message, const void *, void **, void *, void *)
REAL(int, rcl_return_loaned_message_from_subscription, const void *, void *)
REAL(int, rcl_service_init, void *, const void *, const void *, const char *, const void *)
REAL(int, rcl_service_fini, void *, void *)
REAL(const char *, rcl_service_get_service_name, const void *)
REAL(void *, rcl_service_configure_service_introspection, void)
REAL(int, rcl_service_set_on_new_request_callback, const void *, const void *, const void *)
REAL(int, rcl_count_clients, const void *, const char *, size_t *)
REAL(int, rcl_take_request, const void *, struct request_id *, void *)
REAL(int, rcl_take_request_with_info, const void *, struct request_info *, void *)
REAL(int, rcl_send_response, const void *, struct request_id *, void *)
REAL(int, rcl_action_update_goal_state, void *, int)
REAL(int, rcl_action_goal_handle_get_info, const void *, struct goal_info *)
REAL(int, rcl_action_expire_goals, const void *, struct goal_info *, size_t, size_t *)
REAL(int, rcl_wait, struct wait_set *, int64_t)
REAL(int, rcl_trigger_guard_condition, const void *)
REAL(int, rmw_serialize, const void *, const void *, void *)
REAL(int, rmw_deserialize, const void *, const void *, void *)
REAL(void, rcutils_reset_error, void)

/* -- the page ------------------------------------------------------------------------------------------------------- */

/* A message that was written behind the gate. */
struct kept {
  struct kept *next;
  serialized bytes;
};

/* What a request to a ROS action is about. */
struct subject {
  enum about about;
  uint8_t goal[16];
};

/* A goal in progress at a node of this process that the page has no room for. */
struct beyond {
  struct beyond *next;
  uint8_t goal[16];
  unsigned me;
};

/* A request to a ROS action that the node has taken and not answered yet. */
struct taken {
  struct taken *next;
  struct request_id id;
  struct subject subject;
  struct goal *goal; /* that it asks for; NULL: it asks for none, or the page had no room */
  bool adds;         /* another node answers it: it gets the list of what this one has cancelled */
  bool own;          /* the library has made it */
};

/* A request that this node may have to answer later. */
struct held {
  struct held *next;
  struct request_info info;
  serialized bytes;
  struct subject subject;
  struct taken *taken; /* once it is claimed, of a ROS action */
  int64_t at;
  bool claimed;   /* it is this node's to answer */
  bool announced; /* to the callback of its server */
  bool added;     /* it is about many goals, and the node has cancelled its own */
};

/* A request that a server has taken and not answered yet; it may be answered at any time, and by any thread. */
struct unanswered {
  _Atomic uint64_t key; /* of its client and number; 0: free */
  _Atomic int64_t since; /* when it arrived: CLOCK_MONOTONIC, ns; 0: that is about to be noted */
};
/* How many of a server are known at once. */
#define UNANSWERED 32u

/* Which service of a ROS action it is. */
enum service { OTHER, SEND_GOAL, CANCEL_GOAL, GET_RESULT };

/* A publisher, subscription or server of this process whose topic or service is in the page. */
struct entry {
  _Atomic(const void *) endpoint; /* NULL: free; REMOVED: removed */
  struct port *port;
  unsigned me; /* index + 1 of the node that has it */
  unsigned used; /* index of the port among `used_ports` */
  const void *type;
  bool overdue; /* see `enter` */
  struct kept *kept, **kept_end; /* the last messages that were written behind the gate, the oldest first */
  unsigned keeping, most_kept;   /* how many there are, and may be */
  /* Of a server: */
  const void *owner; /* its node */
  struct held *held, **end; /* in the order of arrival. With `lock` */
  _Atomic uint32_t holding; /* how many */
  void (*callback)(const void *, size_t);
  const void *context;
  enum service service;
  const void *response; /* the type of what it answers */
  struct taken *taken; /* with `lock` */
  bool cancelled; /* the library has cancelled all goals */
  struct unanswered unanswered[UNANSWERED];
  _Atomic uint32_t responses; /* how many it has sent to such requests */
};

#define ENTRIES 256u
/* Hashed by the address of the endpoint. Once this one is full there is a next one, which stays: `find` takes no lock. */
struct table {
  struct entry entries[ENTRIES];
  _Atomic(struct table *) next;
};
static struct table first;
#define REMOVED ((const void *)&first)

static struct page *page;
static struct node *node; /* as which the process was started */
static char page_path[PATH_MAX];
static struct beyond *beyond; /* with `lock` */
static uint32_t taken_asked; /* the number of the last request of the manager that was read. With `lock` */
static int descriptor = -1;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* of the tables where they change, and of what is kept */
static pthread_t helper;
static bool helping, stopping;
/* The ports that this process has had endpoints of. With `lock`. */
static struct used_port {
  struct port *port;
  unsigned me;
  uint32_t matched;
  uint32_t waiting;
} *used_ports;
static unsigned used_count;

static int64_t now_ns(void)
{
  struct timespec at;
  clock_gettime(CLOCK_MONOTONIC, &at);
  return at.tv_sec * INT64_C(1000000000) + at.tv_nsec;
}

static size_t length_with(unsigned ports)
{
  return sizeof(struct page) + ports * sizeof(struct port);
}

/* The requests of a role are behind the place of the last port. */
static struct requests *requests_at(struct page *shared, unsigned number)
{
  return (struct requests *)((char *)shared + length_with(MOST_PORTS)) + number;
}

/* The page in `file`; NULL where its layout is not that of this library. `version`: which it has, 0: none. */
static struct page *map_page(int file, uint32_t *version)
{
  struct head head;
  struct stat status;
  *version = 0;
  if (pread(file, &head, sizeof head, 0) != sizeof head || head.magic != PAGE_MAGIC)
    return NULL;
  *version = head.version;
  if (head.version != PAGE_VERSION || head.size != sizeof(struct page) || head.node_size != sizeof(struct node) ||
      head.port_size != sizeof(struct port) || fstat(file, &status) != 0 ||
      status.st_size < (off_t)length_with(head.room))
    return NULL;
  struct page *found = mmap(NULL, length_with(MOST_PORTS) + NODES * sizeof(struct requests), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  return found == MAP_FAILED ? NULL : found;
}

__attribute__((constructor)) static void join(void)
{
  const char *path = getenv(ENV_PAGE), *index = getenv(ENV_NODE);
  if (!path || !index)
    return;
  char *end;
  unsigned long number = strtoul(index, &end, 10);
  if (end == index || *end || number >= NODES || strlen(path) >= sizeof page_path)
    return;
  int file = open(path, O_RDWR | O_CLOEXEC);
  if (file < 0)
    return;
  uint32_t version;
  page = map_page(file, &version);
  if (!page) {
    close(file);
    dprintf(STDERR_FILENO,
            "midstride: this process has no gate: %s has layout %u, and %d is expected; end it by `midstride down` of the "
            "version that started it\n",
            path, version, PAGE_VERSION);
    return;
  }
  descriptor = file;
  node = &page->nodes[number];
  strcpy(page_path, path);
}

/* The lock of a node is held by its process for as long as that lives, and released by the kernel. */
static struct flock lock_of(unsigned index, short type)
{
  return (struct flock){.l_type = type, .l_whence = SEEK_SET, .l_start = index - 1, .l_len = 1};
}

static int is_dead(int file, unsigned index)
{
  struct flock held = lock_of(index, F_WRLCK);
  return fcntl(file, F_GETLK, &held) == 0 && held.l_type == F_UNLCK;
}

/* The entry that is looked for at `step`, from that of its hash on. */
static struct entry *probed(struct table *table, const void *endpoint, unsigned step)
{
  return &table->entries[((unsigned)(((uintptr_t)endpoint >> 4) * UINT32_C(2654435761)) + step) % ENTRIES];
}

static struct entry *find(const void *endpoint)
{
  if (!page)
    return NULL;
  for (struct table *table = &first; table; table = atomic_load_explicit(&table->next, memory_order_acquire))
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
  for (struct table *table = &first;; table = atomic_load(&table->next)) {
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

_Noreturn static void *help(void *);
static void stop_at_exit(void);

/* Give a port back that a node no longer has. */
static void free_port(struct port *port)
{
  atomic_store(&port->kind, UNUSED);
  atomic_store(&port->node, 0);
}

/* A port that is now of the node `own` (index + 1), without a kind; the page grows where none is free. NULL: it cannot. */
static struct port *claim(struct page *shared, int file, unsigned own)
{
  unsigned room = atomic_load(&shared->head.room);
  for (unsigned index = 0;; index++) {
    if (index == room) {
      if (room >= MOST_PORTS || posix_fallocate(file, 0, (off_t)length_with(room + GROWTH)) != 0)
        return NULL;
      if (atomic_compare_exchange_strong(&shared->head.room, &room, room + GROWTH))
        room += GROWTH;
    }
    struct port *port = &shared->ports[index];
    uint32_t free = 0;
    if (atomic_compare_exchange_strong(&port->node, &free, own)) {
      memset(port, 0, offsetof(struct port, node));
      memset(&port->number, 0, sizeof *port - offsetof(struct port, number));
      return port;
    }
  }
}

/* Which node of the page a node of librcl is, as index + 1. */
static unsigned node_of(const void *owner)
{
  unsigned own = (unsigned)(node - page->nodes) + 1;
  const char *name = NULL;
  for (unsigned index = 0; index < NODES; index++) {
    struct node *other = &page->nodes[index];
    if (!atomic_load(&other->used) || other->process != own || !other->name[0])
      continue;
    if (!name && real_rcl_node_get_fully_qualified_name())
      name = real_rcl_node_get_fully_qualified_name()(owner);
    if (name && strncmp(other->name, name, NAME) == 0)
      return index + 1;
  }
  return own;
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
  struct port *port = wanted && strlen(topic) < NAME ? claim(page, descriptor, me) : NULL;
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
  unsigned index = 0;
  while (index < used_count && (used_ports[index].port != port || used_ports[index].me != me))
    index++;
  if (index == used_count) {
    struct used_port *more = realloc(used_ports, (used_count + 1) * sizeof *used_ports);
    if (!more)
      return index;
    used_ports = more;
    used_ports[used_count++] = (struct used_port){.port = port, .me = me};
  }
  return index;
}

/* How many messages of a publisher are kept: of a latched one, as many as a subscriber that comes later gets; else the
 * last. */
static unsigned most_kept(const void *publisher)
{
  const struct qos *qos = real_rcl_publisher_get_actual_qos() ? real_rcl_publisher_get_actual_qos()(publisher) : NULL;
  if (!qos || qos->durability != TRANSIENT_LOCAL || (qos->history == KEEP_LAST && qos->depth <= 1))
    return 1;
  return qos->history == KEEP_LAST && qos->depth < MOST_KEPT ? (unsigned)qos->depth : MOST_KEPT;
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

/* Where `topic` is a port of this node, or a service, remember the endpoint, and have the helper thread run. False where
 * there is no memory for that: the endpoint would have no gate. */
static bool add(const void *endpoint, const void *owner, const char *topic, uint32_t kind, const void *type,
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
  entry->me = me;
  entry->used = used;
  entry->type = type;
  entry->overdue = false;
  entry->kept = NULL;
  entry->kept_end = &entry->kept;
  entry->keeping = 0;
  entry->most_kept = kind == OUTPUT ? most_kept(endpoint) : 0;
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
  stop_at_exit();
  if (!helping) {
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before); /* signals are for the threads of the node */
    helping = pthread_create(&helper, NULL, help, NULL) == 0;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
  }
  pthread_mutex_unlock(&lock);
  return true;
}

/* Keep at most so many of the messages that are kept, the last ones. With `lock`. */
static void discard(struct entry *entry, unsigned remaining)
{
  while (entry->keeping > remaining) {
    struct kept *oldest = entry->kept;
    entry->kept = oldest->next;
    free(oldest->bytes.buffer);
    free(oldest);
    entry->keeping--;
  }
  if (!entry->kept)
    entry->kept_end = &entry->kept;
}

/* No longer hold the request at `place`, which is returned. With `lock`. */
static struct held *unlink_held(struct entry *entry, struct held **place)
{
  struct held *held = *place;
  *place = held->next;
  if (entry->end == &held->next)
    entry->end = place;
  atomic_fetch_sub(&entry->holding, 1);
  return held;
}

static void free_held(struct held *held)
{
  free(held->bytes.buffer);
  free(held->taken);
  free(held);
}

static void forget(const void *endpoint)
{
  struct entry *entry = find(endpoint);
  if (!entry)
    return;
  pthread_mutex_lock(&lock);
  atomic_store_explicit(&entry->endpoint, REMOVED, memory_order_release);
  atomic_fetch_sub(&entry->port->endpoints, 1);
  atomic_store(&entry->port->kept, 0);
  atomic_store(&entry->port->waiting, 0);
  atomic_store(&entry->port->busy, 0);
  discard(entry, 0);
  while (entry->held)
    free_held(unlink_held(entry, &entry->held));
  while (entry->taken) {
    struct taken *next = entry->taken->next;
    free(entry->taken);
    entry->taken = next;
  }
  pthread_mutex_unlock(&lock);
}

/* -- the gate ------------------------------------------------------------------------------------------------------- */

/* A call that may publish: `baton` is NULL where the gate alone decides. */
struct pass {
  struct baton *baton;
  uint64_t entered;
  unsigned flags;
  int again;
};

/* A message of the node `own` (index + 1) of `shared` is about to be published. `file`: the open file of that page.
 * `overdue`: whether a successor has let the patience of this port go by. */
static bool enter(struct page *shared, unsigned own, int file, struct port *port, bool *overdue, struct pass *pass)
{
  pass->baton = NULL;
  if (atomic_load_explicit(&port->gate, memory_order_acquire) != OPEN)
    return false;
  unsigned index = atomic_load_explicit(&port->baton, memory_order_acquire);
  if (index == 0 || index > BATONS)
    return true;
  struct baton *baton = &shared->batons[index - 1];
  pass->flags = atomic_load_explicit(&port->flags, memory_order_relaxed);
  int dead = -1;
  uint64_t seen = atomic_load(&baton->word);
  for (;;) {
    uint64_t next;
    int64_t left = pass->flags & RATED ? atomic_load(&port->half) * INT64_C(1000) : atomic_load(&baton->patience);
    int waited = STATE(seen) == OFFERED && (*overdue || now_ns() - atomic_load(&baton->offered) > left);
    int collided = atomic_load(&baton->collisions) >= COLLISIONS;
    switch (baton_enter(seen, own, pass->flags, waited, collided, dead, &next)) {
    case PASS:
      if (!atomic_compare_exchange_weak(&baton->word, &seen, next)) {
        dead = -1;
        continue;
      }
      pass->baton = baton;
      pass->entered = next;
      pass->again = STATE(seen) == OFFERED && HOLDER(seen) == own && SUCCESSOR(next) != 0;
      *overdue = pass->again && pass->flags & TIMED;
      return true;
    case SKIP:
      if (pass->flags & RATED)
        atomic_store(&baton->collisions, 0);
      return false;
    case ASK:
      /* A process does not see its own locks: two slots may be of one. */
      dead = atomic_load(&shared->nodes[HOLDER(seen) - 1].pid) != (uint32_t)getpid() && is_dead(file, HOLDER(seen));
      continue;
    case BUSY:
      sched_yield();
      seen = atomic_load(&baton->word);
      continue;
    case HOLD_BACK:
      if (SUCCESSOR(seen) == own && STATE(seen) == HELD && WRITERS(seen) != 0)
        atomic_fetch_add(&baton->collisions, 1);
      *overdue = false;
      return false;
    }
  }
}

static void leave(struct pass *pass)
{
  struct baton *baton = pass->baton;
  if (!baton)
    return;
  uint64_t seen = atomic_load(&baton->word), next;
  do {
    next = baton_leave(seen, pass->entered, pass->flags, pass->again);
    if (next == seen)
      return;
    if (STATE(next) == OFFERED)
      atomic_store(&baton->offered, now_ns()); /* before it lies: it is read where it does */
  } while (!atomic_compare_exchange_weak(&baton->word, &seen, next));
}

static void count(struct port *port, bool passed)
{
  int64_t now = now_ns();
  atomic_store_explicit(&port->tried, now, memory_order_relaxed);
  if (passed) {
    atomic_store_explicit(&port->last, now, memory_order_relaxed);
    atomic_fetch_add_explicit(&port->passed, 1, memory_order_relaxed);
  } else {
    atomic_fetch_add_explicit(&port->gated, 1, memory_order_relaxed);
  }
}

/* -- what is written once ------------------------------------------------------------------------------------------- */

static void *allocate(size_t size, void *state)
{
  (void)state;
  return malloc(size);
}

static void deallocate(void *memory, void *state)
{
  (void)state;
  free(memory);
}

static void *reallocate(void *memory, size_t size, void *state)
{
  (void)state;
  return realloc(memory, size);
}

static void *zero_allocate(size_t number, size_t size, void *state)
{
  (void)state;
  return calloc(number, size);
}

/* Keep a message that the gate has held back, as bytes: what it refers to is the node's. */
static void keep(struct entry *entry, const void *message, const serialized *bytes)
{
  struct kept *kept = calloc(1, sizeof *kept);
  if (!kept)
    return;
  kept->bytes.memory = (allocator){allocate, deallocate, reallocate, zero_allocate, NULL};
  bool copied;
  if (bytes) {
    kept->bytes.buffer = malloc(bytes->length ? bytes->length : 1);
    copied = kept->bytes.buffer != NULL;
    if (copied)
      memcpy(kept->bytes.buffer, bytes->buffer, bytes->length);
    kept->bytes.length = kept->bytes.capacity = bytes->length;
  } else {
    copied = real_rmw_serialize() && entry->type && real_rmw_serialize()(message, entry->type, &kept->bytes) == 0;
  }
  if (!copied) {
    free(kept->bytes.buffer);
    free(kept);
    return;
  }
  pthread_mutex_lock(&lock);
  *entry->kept_end = kept;
  entry->kept_end = &kept->next;
  entry->keeping++;
  discard(entry, entry->most_kept);
  atomic_store(&entry->port->kept, 1);
  pthread_mutex_unlock(&lock);
}

/* Publish what is kept, in its order, if it may be published now; or forget it, where nothing is to be kept any more. With
 * `lock`. */
static void publish_kept(struct entry *entry)
{
  struct pass pass;
  if (entry->kept && !(atomic_load_explicit(&entry->port->flags, memory_order_relaxed) & KEEPS)) {
    discard(entry, 0);
    atomic_store(&entry->port->kept, 0);
  }
  if (!entry->kept || !enter(page, entry->me, descriptor, entry->port, &entry->overdue, &pass))
    return;
  const void *publisher = atomic_load(&entry->endpoint);
  for (struct kept *kept = entry->kept; kept; kept = kept->next)
    if (real_rcl_publish_serialized_message()(publisher, &kept->bytes, NULL) == 0)
      count(entry->port, true);
  leave(&pass);
  discard(entry, 0);
  atomic_store(&entry->port->kept, 0);
}

/* -- requests to the services of the node ---------------------------------------------------------------------------- */

/* The executors that wait, each with a guard condition that ends its wait; NULL where it has none. With `lock`. */
struct waiting {
  struct waiting *next;
  const void *guard;
};
static struct waiting *waits;
static pthread_mutex_t client_lock = PTHREAD_MUTEX_INITIALIZER;

/* Whether a request is one of the manager to this node alone. */
static bool is_asked(const struct request_id *id)
{
  return memcmp(id->client, MANAGER, sizeof MANAGER) == 0;
}

/* Those of the role of the node `me` (index + 1); NULL where it answers each that arrives. */
static struct requests *requests_of(unsigned me)
{
  uint32_t number = atomic_load_explicit(&page->nodes[me - 1].requests, memory_order_acquire);
  return number && number <= NODES ? requests_at(page, number - 1) : NULL;
}

/* Whether the process of the node `index` (+ 1) has ended. A process does not see its own locks. */
static bool has_ended(unsigned index)
{
  uint32_t pid = atomic_load(&page->nodes[index - 1].pid);
  return pid && pid != (uint32_t)getpid() && is_dead(descriptor, index);
}

/* Whether the node `other` (index + 1) has the service of `entry`, too. */
static bool has_service(unsigned other, const struct entry *entry)
{
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++) {
    struct port *port = &page->ports[index];
    if (atomic_load(&port->node) == other && atomic_load(&port->kind) == SERVER && atomic_load(&port->endpoints) &&
        strncmp(port->topic, entry->port->topic, NAME) == 0)
      return true;
  }
  return false;
}

/* Whether the node of `entry` answers the requests to its service now. */
static bool answers(struct requests *requests, const struct entry *entry)
{
  unsigned me = entry->me;
  int64_t paused = atomic_load(&requests->paused);
  if (paused && now_ns() < paused)
    return false;
  uint64_t word = atomic_load(&requests->word), next;
  do {
    unsigned before = BEFORE(word);
    if (ANSWERING(word) == me) {
      if (word & BEGUN)
        return true;
      if (before && atomic_load(&page->nodes[before - 1].unanswered) && now_ns() < atomic_load(&requests->until) &&
          !has_ended(before))
        return !has_service(before, entry);
      next = word | BEGUN;
    } else if (before == me && has_ended(ANSWERING(word))) {
      next = requests_take_back(word, me);
    } else {
      return !has_service(ANSWERING(word), entry);
    }
  } while (!atomic_compare_exchange_weak(&requests->word, &word, next));
  return true;
}

/* What distinguishes a client, from the identity of its writer; not 0. */
static uint64_t client_key(const struct request_id *id)
{
  uint64_t parts[2], key = 0;
  memcpy(parts, id->client, sizeof parts);
  for (unsigned part = 0; part < 2; part++) { /* SplitMix64 */
    key += parts[part] + UINT64_C(0x9e3779b97f4a7c15);
    key = (key ^ key >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    key = (key ^ key >> 27) * UINT64_C(0x94d049bb133111eb);
    key ^= key >> 31;
  }
  return key ? key : 1;
}

/* Have the other processes wait, or go on. The kernel releases the lock of one that dies; one that is stopped while it has
 * the lock is not waited for. */
static void lock_clients(struct requests *requests, short type)
{
  struct flock whole = {.l_type = type, .l_whence = SEEK_SET, .l_len = 1};
  whole.l_start = NODES + (requests - requests_at(page, 0));
  int64_t deadline = now_ns() + LOOK;
  while (fcntl(descriptor, F_SETLK, &whole) != 0 && now_ns() < deadline)
    sched_yield();
}

static struct client *find_client(struct requests *requests, uint64_t key)
{
  for (unsigned step = 0; step < CLIENTS; step++) {
    struct client *client = &requests->clients[(key + step) % CLIENTS];
    uint64_t known = atomic_load_explicit(&client->id, memory_order_acquire);
    if (known == key)
      return client;
    if (!known)
      return NULL;
  }
  return NULL;
}

/* The part of a client. Where all are used, it is that of the one from which nothing has been heard for longest. */
static struct client *client_of(struct requests *requests, uint64_t key)
{
  struct client *found = find_client(requests, key);
  if (found)
    return found;
  pthread_mutex_lock(&client_lock);
  lock_clients(requests, F_WRLCK);
  found = find_client(requests, key);
  if (!found) {
    struct client *oldest = NULL;
    for (unsigned step = 0; step < CLIENTS; step++) {
      struct client *client = &requests->clients[(key + step) % CLIENTS];
      if (!atomic_load(&client->id)) {
        oldest = client;
        break;
      }
      if (!oldest || atomic_load(&client->last) < atomic_load(&oldest->last))
        oldest = client;
    }
    found = oldest;
    atomic_store(&found->word, key >> 48 << 48); /* its tag: a step for the client before fails */
    atomic_store(&found->seen, 0);
    atomic_store(&found->last, now_ns());
    atomic_store_explicit(&found->id, key, memory_order_release);
  }
  lock_clients(requests, F_UNLCK);
  pthread_mutex_unlock(&client_lock);
  return found;
}

/* Claim a request; whether this call was the first to do so. `only_look`: do not. */
static bool claim_request(struct requests *requests, const struct request_id *id, bool only_look)
{
  uint64_t key = client_key(id);
  for (;;) {
    struct client *client = client_of(requests, key);
    uint64_t word = atomic_load(&client->word), next;
    while (TAG(word) == key >> 48) {
      if (!requests_claim(word, (uint32_t)id->number, &next))
        return false;
      if (only_look)
        return true;
      if (atomic_compare_exchange_weak(&client->word, &word, next)) {
        atomic_store_explicit(&client->last, now_ns(), memory_order_relaxed);
        return true;
      }
    }
  }
}

#define SEEN(index, number) ((uint64_t)(index) << 48 | ((uint64_t)(number) & UINT64_C(0xffffffffffff)))

/* Note the first request of a client that a successor has received: it receives all later ones, and the node before it
 * answers only what came earlier. */
static void note_seen(struct requests *requests, unsigned me, const struct request_id *id)
{
  uint64_t word = atomic_load(&requests->word);
  if (BEFORE(word) == me || (ANSWERING(word) == me && !BEFORE(word)))
    return;
  struct client *client = client_of(requests, client_key(id));
  atomic_store_explicit(&client->last, now_ns(), memory_order_relaxed);
  if (atomic_load(&client->seen) >> 48 != me)
    atomic_store(&client->seen, SEEN(me, id->number));
}

/* -- goals of ROS actions -------------------------------------------------------------------------------------------- */

/* The request is in memory as its type has it, in C as in C++: the UUID of the goal comes first in each, and in one to
 * cancel a time follows. */
static struct subject subject_of(const struct entry *entry, const void *request)
{
  static const uint8_t none[16];
  struct subject subject = {ABOUT_NONE, {0}};
  if (entry->service == OTHER)
    return subject;
  const struct goal_info *info = request;
  memcpy(subject.goal, info->id, sizeof subject.goal);
  if (entry->service == GET_RESULT)
    subject.about = ABOUT_ONE;
  else if (entry->service == CANCEL_GOAL) {
    bool many = memcmp(info->id, none, sizeof none) == 0 || info->seconds || info->nanoseconds;
    subject.about = many ? ABOUT_MANY : ABOUT_ONE;
  }
  return subject;
}

static struct goal *find_goal(struct requests *requests, const uint8_t *id)
{
  uint64_t parts[2];
  memcpy(parts, id, sizeof parts);
  for (unsigned index = 0; index < GOALS; index++) {
    struct goal *goal = &requests->goals[index];
    if (goal_is_known(atomic_load(&goal->word)) && atomic_load(&goal->id[0]) == parts[0] &&
        atomic_load(&goal->id[1]) == parts[1])
      return goal;
  }
  return NULL;
}

static void step_goal(struct goal *goal, unsigned me, enum goal_event event)
{
  uint64_t word = atomic_load(&goal->word);
  while (!atomic_compare_exchange_weak(&goal->word, &word, goal_step(word, me, event)))
    ;
}

/* A place for a goal that `entry` is about to accept; NULL where each has one that its node may still need. Of those whose
 * result has been fetched, the one that was asked for first is forgotten. */
static struct goal *reserve_goal(struct requests *requests, const struct entry *entry, const struct subject *subject)
{
  for (unsigned tries = 0; tries < GOALS; tries++) {
    struct goal *found = NULL;
    uint64_t word = 0;
    bool free = false;
    for (unsigned index = 0; index < GOALS && !free; index++) {
      struct goal *goal = &requests->goals[index];
      uint64_t seen = atomic_load(&goal->word);
      bool ended = GOAL_STATE(seen) != NO_GOAL && has_ended(OWNER(seen));
      free = GOAL_STATE(seen) == NO_GOAL || ended;
      if (goal_reserve(seen, entry->me, ended) != seen &&
          (free || !found || atomic_load(&goal->at) < atomic_load(&found->at))) {
        found = goal;
        word = seen;
      }
    }
    if (!found)
      return NULL;
    if (atomic_compare_exchange_strong(&found->word, &word, goal_reserve(word, entry->me, true))) {
      uint64_t parts[2];
      memcpy(parts, subject->goal, sizeof parts);
      atomic_store(&found->id[0], parts[0]);
      atomic_store(&found->id[1], parts[1]);
      atomic_store(&found->at, now_ns());
      atomic_store(&found->port, (uint32_t)(entry->port - page->ports) + 1);
      return found;
    }
  }
  return NULL;
}

/* Whether a goal is of the ROS action of `entry`. */
static bool is_of_action(const struct goal *goal, const struct entry *entry)
{
  uint32_t port = atomic_load(&goal->port);
  const char *own = entry->port->topic, *other = port && port <= MOST_PORTS ? page->ports[port - 1].topic : "";
  size_t length = (size_t)(strrchr(own, '/') - own) + 1;
  return strncmp(own, other, length) == 0 && strcmp(other + length, "send_goal") == 0;
}

/* What a node has added to the answer of a request; NULL where it has not. */
static struct added *find_added(struct requests *requests, unsigned index, const struct request_id *id)
{
  for (unsigned place = 0; place < ADDED; place++) {
    struct added *added = &requests->added[place];
    uint64_t word = atomic_load(&added->word);
    if (word & WHOLE && OWNER(word) == index && atomic_load(&added->client) == client_key(id) &&
        atomic_load(&added->number) == id->number)
      return added;
  }
  return NULL;
}

/* Whose turn it is with a request to `entry`, which has arrived at `at`. `own`: whether this node answers what is about no
 * goal. */
static enum turn turn_with(struct requests *requests, const struct entry *entry, const struct subject *subject,
                           const struct request_id *id, int64_t at, bool added, bool own)
{
  bool in_flight = atomic_load(&page->nodes[entry->me - 1].beyond) != 0, missing = false;
  unsigned owner = 0;
  if (subject->about == ABOUT_ONE) {
    struct goal *goal = find_goal(requests, subject->goal);
    owner = goal ? OWNER(atomic_load(&goal->word)) : 0;
    owner = owner && has_ended(owner) ? 0 : owner;
  }
  for (unsigned index = 0; subject->about == ABOUT_MANY && index < GOALS; index++) {
    struct goal *goal = &requests->goals[index];
    uint64_t word = atomic_load(&goal->word);
    if (!goal_in_flight(word) || !is_of_action(goal, entry))
      continue;
    if (OWNER(word) == entry->me)
      in_flight = true;
    else if (now_ns() - at < ADDING && !has_ended(OWNER(word)) && !find_added(requests, OWNER(word), id))
      missing = true;
  }
  return turn_of(subject->about, entry->me, own, owner, in_flight, added, missing);
}

static void answering(struct entry *entry, const struct request_id *id, int64_t since);

/* Claim a request for the node of `entry`, which has had to answer it since `since`; false where it has been claimed.
 * `taken`: what is to be remembered of it until it is answered, NULL for that of any other service than those of a ROS
 * action. */
static bool begin(struct requests *requests, struct entry *entry, const struct request_id *id,
                  const struct subject *subject, int64_t since, struct taken **taken)
{
  struct goal *goal = entry->service == SEND_GOAL ? reserve_goal(requests, entry, subject) : NULL;
  *taken = NULL;
  if (!claim_request(requests, id, false)) {
    if (goal)
      step_goal(goal, entry->me, REJECT);
    return false;
  }
  answering(entry, id, since);
  if (entry->service == OTHER)
    return true;
  if (goal)
    step_goal(goal, entry->me, CLAIM);
  *taken = calloc(1, sizeof **taken);
  if (*taken)
    **taken = (struct taken){.id = *id, .subject = *subject, .goal = goal};
  return true;
}

/* Remember what the node has taken until it answers. */
static void remember(struct entry *entry, struct taken *taken)
{
  if (!taken)
    return;
  pthread_mutex_lock(&lock);
  taken->next = entry->taken;
  entry->taken = taken;
  pthread_mutex_unlock(&lock);
}

/* No longer: it answers. NULL where nothing was remembered. */
static struct taken *recall(struct entry *entry, const struct request_id *id)
{
  struct taken *found = NULL;
  pthread_mutex_lock(&lock);
  for (struct taken **place = &entry->taken; *place && !found; place = found ? place : &(*place)->next)
    if ((*place)->id.number == id->number && memcmp((*place)->id.client, id->client, sizeof id->client) == 0) {
      found = *place;
      *place = found->next;
    }
  pthread_mutex_unlock(&lock);
  return found;
}

/* A response to a request to cancel goals, as bytes: 4 that say how they are ordered, the code, 3 unused, the number of
 * goals in 4, and the goals. */
#define CODE 4
#define NUMBER 8
#define FIRST_GOAL 12

/* Its bytes; false where they are not those of such a response. */
static bool read_cancelled(struct entry *entry, const void *response, serialized *bytes, uint32_t *count)
{
  *bytes = (serialized){.memory = {allocate, deallocate, reallocate, zero_allocate, NULL}};
  if (!entry->response || real_rmw_serialize()(response, entry->response, bytes) != 0) {
    real_rcutils_reset_error()();
    free(bytes->buffer);
    return false;
  }
  bool whole = bytes->length >= FIRST_GOAL;
  if (whole)
    memcpy(count, bytes->buffer + NUMBER, sizeof *count);
  if (whole && bytes->length >= FIRST_GOAL + *count * sizeof(struct goal_info))
    return true;
  free(bytes->buffer);
  return false;
}

/* Leave the list of what this node has cancelled for the one that answers. Where each place is used, the oldest is given
 * up: its request is answered without it. */
static void leave_added(struct requests *requests, struct entry *entry, const struct taken *taken, const void *response)
{
  serialized bytes;
  uint32_t count = 0;
  if (!read_cancelled(entry, response, &bytes, &count))
    return;
  struct added *oldest = &requests->added[0];
  for (unsigned place = 1; place < ADDED; place++)
    if (atomic_load(&requests->added[place].word) >> 32 < atomic_load(&oldest->word) >> 32)
      oldest = &requests->added[place];
  uint64_t highest = 0, word = atomic_load(&oldest->word);
  for (unsigned place = 0; place < ADDED; place++) {
    uint64_t generation = atomic_load(&requests->added[place].word) >> 32;
    highest = generation > highest ? generation : highest;
  }
  uint64_t next = (highest + 1) << 32 | entry->me;
  if (atomic_compare_exchange_strong(&oldest->word, &word, next)) {
    atomic_store(&oldest->client, client_key(&taken->id));
    atomic_store(&oldest->number, taken->id.number);
    count = count < GOALS ? count : GOALS;
    memcpy(oldest->goals, bytes.buffer + FIRST_GOAL, count * sizeof(struct goal_info));
    atomic_store(&oldest->count, count);
    atomic_compare_exchange_strong(&oldest->word, &next, next | WHOLE);
  }
  free(bytes.buffer);
}

/* Add what other nodes have cancelled to the response of this one. */
static void merge_added(struct requests *requests, struct entry *entry, const struct taken *taken, void *response)
{
  serialized bytes;
  uint32_t count = 0;
  if (!read_cancelled(entry, response, &bytes, &count))
    return;
  uint8_t *whole = malloc(FIRST_GOAL + (count + ADDED * GOALS) * sizeof(struct goal_info));
  uint32_t before = count;
  if (whole) {
    memcpy(whole, bytes.buffer, FIRST_GOAL + count * sizeof(struct goal_info));
    for (unsigned place = 0; place < ADDED; place++) {
      struct added *added = &requests->added[place];
      uint64_t word = atomic_load(&added->word);
      if (added != find_added(requests, OWNER(word), &taken->id))
        continue;
      uint8_t *end = whole + FIRST_GOAL + count * sizeof(struct goal_info);
      uint32_t more = 0, all = atomic_load(&added->count);
      for (uint32_t index = 0; index < all && index < GOALS; index++) {
        bool known = false;
        for (uint8_t *each = whole + FIRST_GOAL; each < end && !known; each += sizeof(struct goal_info))
          known = memcmp(each, added->goals[index].id, sizeof added->goals[index].id) == 0;
        if (!known)
          memcpy(end + more++ * sizeof(struct goal_info), &added->goals[index], sizeof(struct goal_info));
      }
      if (atomic_load(&added->word) == word) /* else it was given up meanwhile */
        count += more;
    }
  }
  if (count > before) {
    whole[CODE] = 0; /* ERROR_NONE */
    memcpy(whole + NUMBER, &count, sizeof count);
    serialized merged = {whole, FIRST_GOAL + count * sizeof(struct goal_info), 0, bytes.memory};
    merged.capacity = merged.length;
    if (real_rmw_deserialize()(&merged, entry->response, response) != 0)
      real_rcutils_reset_error()();
  }
  free(whole);
  free(bytes.buffer);
}

/* A goal that the page has no room for is accepted: the node is waited for until it has ended, too. */
static void accept_beyond(const struct entry *entry, const struct subject *subject)
{
  struct beyond *accepted = malloc(sizeof *accepted);
  if (!accepted)
    return;
  memcpy(accepted->goal, subject->goal, sizeof accepted->goal);
  accepted->me = entry->me;
  pthread_mutex_lock(&lock);
  accepted->next = beyond;
  beyond = accepted;
  atomic_fetch_add(&page->nodes[entry->me - 1].beyond, 1);
  pthread_mutex_unlock(&lock);
}

/* Such a goal has ended. With `lock`. */
static void end_beyond(const uint8_t *goal)
{
  for (struct beyond **place = &beyond; *place; place = &(*place)->next)
    if (memcmp((*place)->goal, goal, sizeof (*place)->goal) == 0) {
      struct beyond *ended = *place;
      *place = ended->next;
      atomic_fetch_sub(&page->nodes[ended->me - 1].beyond, 1);
      free(ended);
      return;
    }
}

/* Something has happened to a goal of this process. */
static void on_goal(const struct goal_info *info, enum goal_event event)
{
  pthread_mutex_lock(&lock);
  if (event == END)
    end_beyond(info->id);
  for (struct table *table = &first; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++) {
      struct entry *entry = &table->entries[index];
      const void *endpoint = atomic_load(&entry->endpoint);
      struct requests *requests =
          endpoint && endpoint != REMOVED && entry->service == SEND_GOAL ? requests_of(entry->me) : NULL;
      struct goal *goal = requests ? find_goal(requests, info->id) : NULL;
      if (goal)
        step_goal(goal, entry->me, event);
    }
  pthread_mutex_unlock(&lock);
}

/* rcl_action_goal_event_t */
enum { GOAL_EVENT_SUCCEED = 2, GOAL_EVENT_CANCELED = 4 };

EXPORT int rcl_action_update_goal_state(void *handle, int event)
{
  int result = real_rcl_action_update_goal_state()(handle, event);
  struct goal_info info;
  if (page && result == 0 && event >= GOAL_EVENT_SUCCEED && event <= GOAL_EVENT_CANCELED &&
      real_rcl_action_goal_handle_get_info()(handle, &info) == 0)
    on_goal(&info, END);
  return result;
}

EXPORT int rcl_action_expire_goals(const void *server, struct goal_info *expired, size_t capacity, size_t *number)
{
  int result = real_rcl_action_expire_goals()(server, expired, capacity, number);
  for (size_t index = 0; page && result == 0 && expired && index < *number && index < capacity; index++)
    on_goal(&expired[index], EXPIRE);
  return result;
}

/* -- requests that are held ------------------------------------------------------------------------------------------ */

/* Hold a request: another node answers, or is to. Not where it cannot be copied: then it is left to the other one.
 * `added`: this node has taken it, to add to the answer. */
static void hold(struct entry *entry, const struct request_info *info, const void *request,
                 const struct subject *subject, bool added)
{
  struct held *held = calloc(1, sizeof *held), *surplus = NULL;
  if (!held)
    return;
  held->info = *info;
  held->subject = *subject;
  held->added = added;
  held->at = now_ns();
  held->bytes.memory = (allocator){allocate, deallocate, reallocate, zero_allocate, NULL};
  if (real_rmw_serialize()(request, entry->type, &held->bytes) != 0) {
    real_rcutils_reset_error()();
    free_held(held);
    return;
  }
  pthread_mutex_lock(&lock);
  *entry->end = held;
  entry->end = &held->next;
  if (atomic_fetch_add(&entry->holding, 1) == MOST_HELD)
    surplus = unlink_held(entry, &entry->held);
  pthread_mutex_unlock(&lock);
  if (surplus)
    free_held(surplus);
}

/* What distinguishes a request; not 0. */
static uint64_t request_key(const struct request_id *id)
{
  uint64_t key = client_key(id) + (uint64_t)id->number * UINT64_C(0x9e3779b97f4a7c15);
  return key ? key : 1;
}

/* Since when the oldest request of a server is not answered; 0: each is. */
static int64_t oldest_of(const struct entry *entry)
{
  int64_t oldest = 0;
  for (unsigned place = 0; place < UNANSWERED; place++) {
    int64_t since = atomic_load_explicit(&entry->unanswered[place].since, memory_order_relaxed);
    if (since && (!oldest || since < oldest))
      oldest = since;
  }
  return oldest;
}

/* A server has a request. One beyond those that there is room for is not measured. What two threads may leave wrong of the
 * oldest one, the helper thread corrects when it looks next. */
static void note_taken(struct entry *entry, const struct request_id *id, int64_t since)
{
  uint64_t key = request_key(id);
  for (unsigned step = 0; step < UNANSWERED; step++) {
    struct unanswered *place = &entry->unanswered[(key + step) % UNANSWERED];
    uint64_t free = 0;
    if (!atomic_compare_exchange_strong(&place->key, &free, key))
      continue;
    atomic_store(&place->since, since);
    int64_t oldest = atomic_load(&entry->port->waiting);
    if (!oldest || since < oldest)
      atomic_store(&entry->port->waiting, since);
    return;
  }
}

/* It has answered the request, or has it no longer: `sent` says whether it has. */
static void note_answered(struct entry *entry, const struct request_id *id, bool sent)
{
  uint64_t key = request_key(id);
  for (unsigned step = 0; step < UNANSWERED; step++) {
    struct unanswered *place = &entry->unanswered[(key + step) % UNANSWERED];
    if (atomic_load(&place->key) != key)
      continue;
    int64_t took = (now_ns() - atomic_load(&place->since)) / 1000;
    atomic_store(&place->since, 0);
    atomic_store(&place->key, 0);
    atomic_store(&entry->port->waiting, oldest_of(entry));
    if (!sent)
      return;
    uint32_t number = atomic_fetch_add(&entry->responses, 1);
    atomic_store(&entry->port->took[number % LATEST], took < UINT32_MAX ? (uint32_t)took : UINT32_MAX);
    atomic_store(&entry->port->answered, number + 1);
    return;
  }
}

static void answering(struct entry *entry, const struct request_id *id, int64_t since)
{
  count(entry->port, true);
  if (entry->service == GET_RESULT) /* which is answered when the goal has ended */
    return;
  atomic_fetch_add(&page->nodes[entry->me - 1].unanswered, 1);
  note_taken(entry, id, since);
}

void midstride_ring(struct page *shared, unsigned index);

/* Have the node that answers look at once. */
static void ring_others(const struct entry *entry)
{
  uint64_t word = atomic_load(&requests_of(entry->me)->word);
  if (ANSWERING(word) && ANSWERING(word) != entry->me)
    midstride_ring(page, ANSWERING(word) - 1);
}

/* A request of this node needs no more to be waited for; `sent`: it has been answered. */
static void answered(struct entry *entry, struct requests *requests, const struct request_id *id, bool sent)
{
  struct node *own = &page->nodes[entry->me - 1];
  atomic_store(&own->answered, now_ns());
  if (entry->service == GET_RESULT)
    return;
  note_answered(entry, id, sent);
  uint32_t left = atomic_load(&own->unanswered);
  while (left && !atomic_compare_exchange_weak(&own->unanswered, &left, left - 1))
    ;
  uint64_t word = atomic_load(&requests->word);
  if (left == 1 && BEFORE(word) == entry->me && ANSWERING(word) && !(word & BEGUN))
    midstride_ring(page, ANSWERING(word) - 1);
}

static enum turn turn_with_held(struct requests *requests, const struct entry *entry, const struct held *held)
{
  bool own = answers(requests, entry);
  return turn_with(requests, entry, &held->subject, &held->info.id, held->at, held->added, own);
}

/* A copy of a request, to add to the answer of another node; it stays held, in case this one is to answer in the end. NULL
 * where there is no memory. With `lock`. */
static struct held *copied_to_add(struct held *held)
{
  struct held *copy = calloc(1, sizeof *copy);
  if (!copy)
    return NULL;
  *copy = *held;
  copy->next = NULL;
  copy->bytes.buffer = malloc(held->bytes.length);
  copy->taken = calloc(1, sizeof *copy->taken);
  if (!copy->bytes.buffer || !copy->taken) {
    free_held(copy);
    return NULL;
  }
  memcpy(copy->bytes.buffer, held->bytes.buffer, held->bytes.length);
  copy->bytes.capacity = held->bytes.length;
  *copy->taken = (struct taken){.id = held->info.id, .subject = held->subject, .adds = true};
  held->added = true;
  held->announced = false;
  return copy;
}

/* The first of the requests that are held which is this node's to take; NULL where there is none. */
static struct held *due(struct entry *entry, struct requests *requests)
{
  if (!atomic_load(&entry->holding))
    return NULL;
  struct held *found = NULL, *claimed_elsewhere = NULL;
  pthread_mutex_lock(&lock);
  for (struct held **place = &entry->held; *place && !found;) {
    struct held *held = *place;
    enum turn turn = held->claimed ? ANSWER : turn_with_held(requests, entry, held);
    if (held->claimed) {
      found = unlink_held(entry, place);
    } else if (turn != ANSWER) {
      if (turn == ADD && claim_request(requests, &held->info.id, true))
        found = copied_to_add(held);
      place = &held->next;
    } else if (begin(requests, entry, &held->info.id, &held->subject, now_ns(), &held->taken)) {
      found = unlink_held(entry, place);
    } else {
      held = unlink_held(entry, place);
      held->next = claimed_elsewhere;
      claimed_elsewhere = held;
    }
  }
  pthread_mutex_unlock(&lock);
  while (claimed_elsewhere) {
    struct held *next = claimed_elsewhere->next;
    free_held(claimed_elsewhere);
    claimed_elsewhere = next;
  }
  return found;
}

/* Give the node a request that was held; false where none is due. */
static bool take_held(struct entry *entry, struct requests *requests, struct request_info *info, void *request)
{
  struct held *held;
  while ((held = due(entry, requests))) {
    bool read = real_rmw_deserialize()(&held->bytes, entry->type, request) == 0;
    bool own = !held->taken || !(held->taken->adds || held->taken->own);
    *info = held->info;
    if (read) {
      remember(entry, held->taken);
      held->taken = NULL;
    }
    free_held(held);
    if (read)
      return true;
    real_rcutils_reset_error()();
    if (own && !is_asked(&info->id))
      answered(entry, requests, &info->id, false);
  }
  return false;
}

/* Whether a server of the node has a request which it is to take that the middleware does not know of. With `lock`. */
static bool is_due(struct entry *entry)
{
  struct requests *requests =
      entry && entry->port->kind == SERVER && atomic_load(&entry->holding) ? requests_of(entry->me) : NULL;
  for (struct held *held = requests ? entry->held : NULL; held; held = held->next)
    if (held->claimed || turn_with_held(requests, entry, held) != WAIT)
      return true;
  return false;
}

/* Have the executor take what is due. With `lock`. */
static void announce(struct entry *entry)
{
  for (struct waiting *waiting = waits; waiting; waiting = waiting->next)
    if (waiting->guard)
      real_rcl_trigger_guard_condition()(waiting->guard);
  if (!entry->callback)
    return;
  size_t number = 0;
  struct requests *requests = requests_of(entry->me);
  for (struct held *held = entry->held; held; held = held->next)
    if (!held->announced && (held->claimed || turn_with_held(requests, entry, held) != WAIT)) {
      held->announced = true;
      number++;
    }
  if (number)
    entry->callback(entry->context, number);
}

/* What is held of a server: forget what another node has claimed; claim what its successor has not received. With `lock`. */
static uint32_t look_at_held(struct entry *entry, struct requests *requests)
{
  int64_t now = now_ns();
  uint32_t waiting = 0;
  uint64_t word = atomic_load(&requests->word);
  for (struct held **place = &entry->held; *place;) {
    struct held *held = *place;
    if (!held->claimed && (now - held->at > HOLD || !claim_request(requests, &held->info.id, true))) {
      free_held(unlink_held(entry, place));
      continue;
    }
    if (!held->claimed && BEFORE(word) == entry->me && now - held->at > LEFT_OVER) {
      uint64_t seen = atomic_load(&client_of(requests, client_key(&held->info.id))->seen);
      bool received = seen >> 48 == ANSWERING(word) && seen <= SEEN(ANSWERING(word), held->info.id.number);
      /* As if this node answered: what is about a goal of its successor is still that one's. */
      bool own = turn_with(requests, entry, &held->subject, &held->info.id, held->at, held->added, true) == ANSWER;
      if (!received && own && begin(requests, entry, &held->info.id, &held->subject, now, &held->taken))
        held->claimed = true;
    }
    waiting += !held->claimed;
    place = &held->next;
  }
  return waiting;
}

/* Have the node cancel all goals that it has, by a request which no other one gets. With `lock`. */
static void cancel_all(struct entry *entry)
{
  struct held *held = calloc(1, sizeof *held);
  if (!held)
    return;
  held->taken = calloc(1, sizeof *held->taken);
  held->bytes.length = held->bytes.capacity = CODE + sizeof(struct goal_info);
  held->bytes.buffer = calloc(1, held->bytes.length);
  if (!held->taken || !held->bytes.buffer) {
    free_held(held);
    return;
  }
  held->bytes.memory = (allocator){allocate, deallocate, reallocate, zero_allocate, NULL};
  held->bytes.buffer[1] = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__; /* no goal, no time: all of them */
  held->info.id.number = -1;
  held->taken->id = held->info.id;
  held->taken->subject.about = ABOUT_MANY;
  held->taken->own = held->claimed = true;
  *entry->end = held;
  entry->end = &held->next;
  atomic_fetch_add(&entry->holding, 1);
  entry->cancelled = true;
}

/* With `lock`. */
static void look_at_server(struct entry *entry, const void *server)
{
  struct requests *requests = requests_of(entry->me);
  if (!requests)
    return;
  if (entry->service == CANCEL_GOAL && !entry->cancelled && atomic_load(&page->nodes[entry->me - 1].cancels))
    cancel_all(entry);
  size_t clients = 0;
  if (atomic_load(&requests->shared) && real_rcl_count_clients()) {
    const char *name = real_rcl_service_get_service_name()(server);
    if (name && real_rcl_count_clients()(entry->owner, name, &clients) == 0)
      used_ports[entry->used].matched += (uint32_t)clients;
    else
      real_rcutils_reset_error()();
  }
  uint32_t waiting = atomic_load(&entry->holding) ? look_at_held(entry, requests) : 0;
  used_ports[entry->used].waiting += waiting;
  atomic_store(&entry->port->waiting, oldest_of(entry));
  if (is_due(entry))
    announce(entry);
}

/* -- requests of the manager to this node alone -----------------------------------------------------------------------
 *
 * The two nodes of a hand-over have one name, so a request by ROS reaches both. The manager puts one that is for this node
 * into a file instead, and counts it in the page; the executor of the node takes it like any other, and the response goes
 * into another file.
 */

/* The name of the file of the request `number`, or, by its `suffix`, of another one of it. */
static void asked_file(char *name, uint32_t number, const char *suffix)
{
  snprintf(name, FILE_NAME, "%s.%u.%u%s", page_path, (unsigned)(node - page->nodes), number, suffix);
}

/* The server of that name; NULL where there is none. With `lock`. */
static struct entry *server_of(const char *name)
{
  unsigned own = (unsigned)(node - page->nodes) + 1;
  for (struct table *table = &first; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++) {
      struct entry *entry = &table->entries[index];
      const void *endpoint = atomic_load(&entry->endpoint);
      if (endpoint && endpoint != REMOVED && entry->me == own && entry->port->kind == SERVER &&
          strncmp(entry->port->topic, name, NAME) == 0)
        return entry;
    }
  return NULL;
}

/* The bytes of a file, with a 0 behind them; NULL where it cannot be read. */
static uint8_t *read_file(const char *name, size_t *length)
{
  int file = open(name, O_RDONLY | O_CLOEXEC);
  struct stat status;
  uint8_t *bytes = file >= 0 && fstat(file, &status) == 0 ? malloc((size_t)status.st_size + 1) : NULL;
  bool whole = bytes && read(file, bytes, (size_t)status.st_size) == status.st_size;
  if (file >= 0)
    close(file);
  if (!whole) {
    free(bytes);
    return NULL;
  }
  *length = (size_t)status.st_size;
  bytes[*length] = 0;
  return bytes;
}

/* Hold a request of the manager for the executor. The file has the name of the service, a 0, and the request. With `lock`. */
static void hold_asked(uint32_t number)
{
  char name[FILE_NAME];
  size_t length;
  asked_file(name, number, "");
  uint8_t *bytes = read_file(name, &length);
  if (!bytes)
    return;
  size_t begin = strlen((char *)bytes) + 1;
  struct entry *entry = begin <= length ? server_of((char *)bytes) : NULL;
  struct held *held = entry ? calloc(1, sizeof *held) : NULL;
  if (!held) {
    free(bytes);
    return;
  }
  memmove(bytes, bytes + begin, length - begin);
  held->bytes.buffer = bytes;
  held->bytes.length = length - begin;
  held->bytes.capacity = length + 1;
  held->bytes.memory = (allocator){allocate, deallocate, reallocate, zero_allocate, NULL};
  memcpy(held->info.id.client, MANAGER, sizeof MANAGER);
  held->info.id.number = number;
  held->at = now_ns();
  held->claimed = true;
  *entry->end = held;
  entry->end = &held->next;
  atomic_fetch_add(&entry->holding, 1);
}

/* With `lock`. */
static void take_asked(void)
{
  for (uint32_t last = atomic_load(&node->asked); taken_asked != last;)
    hold_asked(++taken_asked);
}

/* Write the response to a request of the manager into its file, which is there once it is whole. */
static int respond(const struct entry *entry, const struct request_id *id, const void *response)
{
  char name[FILE_NAME], partial[FILE_NAME];
  serialized bytes = {.memory = {allocate, deallocate, reallocate, zero_allocate, NULL}};
  int result = real_rmw_serialize()(response, entry->response, &bytes);
  if (result == 0) {
    asked_file(name, (uint32_t)id->number, ".answer");
    asked_file(partial, (uint32_t)id->number, ".partial");
    int file = open(partial, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (file >= 0 && write(file, bytes.buffer, bytes.length) == (ssize_t)bytes.length)
      rename(partial, name);
    if (file >= 0)
      close(file);
  }
  free(bytes.buffer);
  return result;
}

/* -- the helper thread: what is kept, and with how many endpoints each port is matched ------------------------------ */

static void wait_for_bell(_Atomic uint32_t *bell, uint32_t seen)
{
  struct timespec timeout = {0, LOOK};
  syscall(SYS_futex, (uint32_t *)bell, FUTEX_WAIT, seen, &timeout, NULL, 0);
}

static void look_at(struct entry *entry)
{
  const void *endpoint = atomic_load(&entry->endpoint);
  if (!endpoint || endpoint == REMOVED)
    return;
  if (entry->port->kind == SERVER) {
    look_at_server(entry, endpoint);
    return;
  }
  bool output = entry->port->kind == OUTPUT;
  int (*counting)(const void *, size_t *) =
      output ? real_rcl_publisher_get_subscription_count() : real_rcl_subscription_get_publisher_count();
  size_t number = 0;
  if (counting && counting(endpoint, &number) == 0)
    used_ports[entry->used].matched += (uint32_t)number;
  else if (real_rcutils_reset_error())
    real_rcutils_reset_error()();
  if (output)
    publish_kept(entry);
}

static void look(void)
{
  take_asked();
  for (unsigned index = 0; index < used_count; index++)
    used_ports[index].matched = used_ports[index].waiting = 0;
  for (struct table *table = &first; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++)
      look_at(&table->entries[index]);
  for (unsigned index = 0; index < used_count; index++) {
    struct used_port *used = &used_ports[index];
    if (atomic_load(&used->port->node) != used->me)
      continue;
    atomic_store(&used->port->matched, used->matched);
    if (used->port->kind == SERVER)
      atomic_store(&used->port->gated, used->waiting);
  }
}

static void stop_helping(void)
{
  pthread_mutex_lock(&lock);
  stopping = true;
  pthread_mutex_unlock(&lock);
}

/* Have the helper thread stop before what the middleware keeps is destroyed. At exit, what was registered last comes first,
 * and the middleware registers what it makes for its first endpoints; so this is done for each of them, and not in the
 * thread, which may not have run yet when the process ends. With `lock`. */
static void stop_at_exit(void)
{
  static unsigned registered;
  if (registered < ENTRIES && atexit(stop_helping) == 0)
    registered++;
}

_Noreturn static void *help(void *unused)
{
  (void)unused;
  for (;;) {
    uint32_t seen = atomic_load(&node->bell);
    pthread_mutex_lock(&lock);
    if (stopping) {
      pthread_mutex_unlock(&lock);
      /* To end here would destroy what the middleware keeps for this thread, while the process destroys the rest. */
      for (;;)
        pause();
    }
    look();
    pthread_mutex_unlock(&lock);
    atomic_fetch_add(&node->beat, 1);
    wait_for_bell(&node->bell, seen);
  }
}

/* -- the nodes of the process --------------------------------------------------------------------------------------- */

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
  struct port *port = claim(page, descriptor, (unsigned)(node - page->nodes) + 1);
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

/* -- the functions of librcl ---------------------------------------------------------------------------------------- */

/* Mark the node by the identity of the first publisher of its process, by which the graph shows what belongs to it. */
static void mark(const void *publisher)
{
  if (atomic_load(&node->marked) || !real_rcl_publisher_get_rmw_handle() || !real_rmw_get_gid_for_publisher())
    return;
  struct identity identity;
  if (real_rmw_get_gid_for_publisher()(real_rcl_publisher_get_rmw_handle()(publisher), &identity) != 0) {
    if (real_rcutils_reset_error())
      real_rcutils_reset_error()();
    return;
  }
  pthread_mutex_lock(&lock);
  if (!atomic_load(&node->marked)) {
    memcpy(node->mark, identity.data, MARK);
    atomic_store(&node->marked, 1);
  }
  pthread_mutex_unlock(&lock);
}

EXPORT int rcl_publisher_init(void *publisher, const void *owner, const void *type, const char *name, const void *options)
{
  int result = real_rcl_publisher_init()(publisher, owner, type, name, options);
  if (page && result == 0 && !add(publisher, owner, real_rcl_publisher_get_topic_name()(publisher), OUTPUT, type, NULL)) {
    real_rcl_publisher_fini()(publisher, (void *)owner);
    return BAD_ALLOC;
  }
  if (page && result == 0)
    mark(publisher);
  return result;
}

EXPORT int rcl_publisher_fini(void *publisher, void *owner)
{
  forget(publisher);
  return real_rcl_publisher_fini()(publisher, owner);
}

EXPORT int rcl_subscription_init(void *subscription, const void *owner, const void *type, const char *name,
                                 const void *options)
{
  int result = real_rcl_subscription_init()(subscription, owner, type, name, options);
  if (page && result == 0 &&
      !add(subscription, owner, real_rcl_subscription_get_topic_name()(subscription), INPUT, type, NULL)) {
    real_rcl_subscription_fini()(subscription, (void *)owner);
    return BAD_ALLOC;
  }
  return result;
}

EXPORT int rcl_subscription_fini(void *subscription, void *owner)
{
  forget(subscription);
  return real_rcl_subscription_fini()(subscription, owner);
}

/* The type of the requests to a service; NULL where it is not known. */
static const void *request_type(const struct service_type *type)
{
  /* Before Iron, the type of a service does not have it. */
  bool known = type && real_rcl_service_configure_service_introspection();
  return known && real_rmw_serialize() && real_rmw_deserialize() && real_rcutils_reset_error() ? type->request : NULL;
}

EXPORT int rcl_service_init(void *service, const void *owner, const void *type, const char *name,
                            const struct service_options *options)
{
  const void *request = page ? request_type(type) : NULL;
  if (!request || !options)
    return real_rcl_service_init()(service, owner, type, name, options);
  struct service_options deeper = *options;
  if (deeper.history == KEEP_LAST && deeper.depth < QUEUE)
    deeper.depth = QUEUE;
  int result = real_rcl_service_init()(service, owner, type, name, &deeper);
  if (result == 0 && !add(service, owner, real_rcl_service_get_service_name()(service), SERVER, request,
                          ((const struct service_type *)type)->response)) {
    real_rcl_service_fini()(service, (void *)owner);
    return BAD_ALLOC;
  }
  return result;
}

EXPORT int rcl_service_fini(void *service, void *owner)
{
  forget(service);
  return real_rcl_service_fini()(service, owner);
}

EXPORT int rcl_service_set_on_new_request_callback(const void *service, void (*callback)(const void *, size_t),
                                                   const void *context)
{
  struct entry *entry = find(service);
  if (entry) {
    pthread_mutex_lock(&lock);
    entry->callback = callback;
    entry->context = context;
    atomic_store(&entry->port->busy, 0); /* which is known of executors that wait */
    pthread_mutex_unlock(&lock);
  }
  return real_rcl_service_set_on_new_request_callback()(service, callback, context);
}

/* Of the two functions that take a request, one may call the other: then that one knows when the request was received. */
static _Thread_local bool taking;
static _Thread_local int64_t received;

/* A clock that is set by more than this between the arrival of a request and its being taken is noticed (ns). */
#define LONGEST_WAIT INT64_C(60000000000)

/* When a request arrived that is taken now, by when the middleware says that it was received: CLOCK_REALTIME, ns; it may not
 * say so (0), or that clock may have been set. */
static int64_t arrival(int64_t by_the_middleware)
{
  int64_t now = now_ns();
  if (by_the_middleware <= 0)
    return now;
  struct timespec at;
  clock_gettime(CLOCK_REALTIME, &at);
  int64_t waited = at.tv_sec * INT64_C(1000000000) + at.tv_nsec - by_the_middleware;
  return waited > 0 && waited < LONGEST_WAIT ? now - waited : now;
}

/* Take a request with `real_take`, or one that was held. */
static int take_request(const void *service, struct request_info *info, void *request, bool with_info)
{
  struct entry *entry = taking ? NULL : find(service);
  struct requests *requests = entry ? requests_of(entry->me) : NULL;
  if (requests && take_held(entry, requests, info, request))
    return 0;
  bool nested = taking;
  taking = true;
  received = 0;
  int result = with_info ? real_rcl_take_request_with_info()(service, info, request)
                         : real_rcl_take_request()(service, &info->id, request);
  taking = nested;
  if (with_info && result == 0)
    received = info->received;
  if (result != 0 || !requests)
    return result;
  note_seen(requests, entry->me, &info->id);
  struct subject subject = subject_of(entry, request);
  struct taken *taken = NULL;
  switch (turn_with(requests, entry, &subject, &info->id, now_ns(), false, answers(requests, entry))) {
  case ANSWER:
    if (!begin(requests, entry, &info->id, &subject, arrival(received), &taken))
      return NO_REQUEST;
    remember(entry, taken);
    return 0;
  case ADD:
    if (!claim_request(requests, &info->id, true) || !(taken = calloc(1, sizeof *taken)))
      return NO_REQUEST;
    *taken = (struct taken){.id = info->id, .subject = subject, .adds = true};
    hold(entry, info, request, &subject, true);
    remember(entry, taken);
    return 0;
  case WAIT:
    hold(entry, info, request, &subject, false);
  }
  pthread_mutex_lock(&lock);
  if (is_due(entry)) /* since meanwhile it is to answer */
    announce(entry);
  pthread_mutex_unlock(&lock);
  return NO_REQUEST;
}

EXPORT int rcl_take_request_with_info(const void *service, struct request_info *info, void *request)
{
  return take_request(service, info, request, true);
}

EXPORT int rcl_take_request(const void *service, struct request_id *id, void *request)
{
  struct request_info info = {.id = *id};
  int result = take_request(service, &info, request, false);
  *id = info.id;
  return result;
}

/* Answer with the result of a goal whose node has ended, if the manager has kept it in a file: no client had fetched it. */
static void answer_kept(const struct entry *entry, const uint8_t *goal, void *response)
{
  char name[FILE_NAME];
  int end = snprintf(name, FILE_NAME, "%s.result.", page_path);
  for (unsigned index = 0; index < 16; index++)
    end += snprintf(name + end, FILE_NAME - (size_t)end, "%02x", goal[index]);
  serialized bytes = {.memory = {allocate, deallocate, reallocate, zero_allocate, NULL}};
  bytes.buffer = entry->response ? read_file(name, &bytes.length) : NULL;
  bytes.capacity = bytes.length + 1;
  if (bytes.buffer && real_rmw_deserialize()(&bytes, entry->response, response) != 0)
    real_rcutils_reset_error()();
  free(bytes.buffer);
}

EXPORT int rcl_send_response(const void *service, struct request_id *id, void *response)
{
  struct entry *entry = find(service);
  if (entry && is_asked(id))
    return respond(entry, id, response);
  struct requests *requests = entry ? requests_of(entry->me) : NULL;
  if (!requests)
    return real_rcl_send_response()(service, id, response);
  struct taken *taken = entry->service == OTHER ? NULL : recall(entry, id);
  if (taken && (taken->adds || taken->own)) { /* not this node's to answer */
    if (taken->adds)
      leave_added(requests, entry, taken, response);
    free(taken);
    ring_others(entry);
    return 0;
  }
  if (taken && entry->service == CANCEL_GOAL && taken->subject.about == ABOUT_MANY)
    merge_added(requests, entry, taken, response);
  /* The response to the request for a goal begins with whether it is accepted; that with a result, with its status. */
  int8_t begins = 0;
  memcpy(&begins, response, sizeof begins);
  if (taken && entry->service == SEND_GOAL) {
    if (taken->goal)
      step_goal(taken->goal, entry->me, begins ? ACCEPT : REJECT);
    else if (begins)
      accept_beyond(entry, &taken->subject);
  }
  if (taken && entry->service == GET_RESULT && !begins) /* the node does not know the goal */
    answer_kept(entry, taken->subject.goal, response);
  int result = real_rcl_send_response()(service, id, response);
  struct goal *goal = taken && entry->service == GET_RESULT && begins ? find_goal(requests, taken->subject.goal) : NULL;
  if (goal && result == 0)
    step_goal(goal, entry->me, FETCH);
  free(taken);
  answered(entry, requests, id, true);
  return result;
}

/* Since when no executor waits for requests to a server; 0: one begins to. */
static void note_busy(const void *service, int64_t since)
{
  struct entry *entry = service ? find(service) : NULL;
  if (entry && !entry->callback)
    atomic_store_explicit(&entry->port->busy, since, memory_order_relaxed);
}

/* Servers with a request that is held are ready once the node is to answer it. */
EXPORT int rcl_wait(struct wait_set *set, int64_t timeout)
{
  if (!page || !set || !set->impl || !set->service_count)
    return real_rcl_wait()(set, timeout);
  for (size_t index = 0; index < set->service_count; index++)
    note_busy(set->services[index], 0);
  if (set->service_count > ENTRIES)
    return real_rcl_wait()(set, timeout);
  const void *services[ENTRIES];
  size_t count = set->service_count;
  memcpy(services, set->services, count * sizeof *services);
  struct waiting own = {0};
  for (size_t index = 0; index < set->guard_count && !own.guard; index++)
    own.guard = set->guards[index];
  bool shortened = false;
  pthread_mutex_lock(&lock);
  for (size_t index = 0; index < count; index++) {
    struct entry *entry = services[index] ? find(services[index]) : NULL;
    if (is_due(entry))
      timeout = 0;
    else if (entry && atomic_load(&entry->holding))
      shortened = shortened || (!own.guard && (timeout < 0 || timeout > SHORT_WAIT));
  }
  if (shortened && timeout != 0)
    timeout = SHORT_WAIT;
  own.next = waits;
  waits = &own;
  pthread_mutex_unlock(&lock);
  int result = real_rcl_wait()(set, timeout);
  int64_t now = now_ns();
  for (size_t index = 0; index < count; index++)
    note_busy(services[index], now);
  pthread_mutex_lock(&lock);
  struct waiting **place = &waits;
  while (*place != &own)
    place = &(*place)->next;
  *place = own.next;
  bool ready = false;
  for (size_t index = 0; index < count && (result == 0 || result == TIMED_OUT); index++) {
    struct entry *entry = services[index] && !set->services[index] ? find(services[index]) : NULL;
    /* A shortened wait has not timed out for its caller, who takes, finds no request, and waits again. */
    if (is_due(entry) || (entry && shortened && result == TIMED_OUT && atomic_load(&entry->holding))) {
      set->services[index] = services[index];
      ready = true;
    }
  }
  pthread_mutex_unlock(&lock);
  return ready ? 0 : result;
}

/* Whether a message may be published. One that is kept comes first. */
static bool admitted(struct entry *entry, struct pass *pass)
{
  if (atomic_load_explicit(&entry->port->kept, memory_order_relaxed)) {
    pthread_mutex_lock(&lock);
    publish_kept(entry);
    pthread_mutex_unlock(&lock);
  }
  return enter(page, entry->me, descriptor, entry->port, &entry->overdue, pass);
}

static void held_back(struct entry *entry, const void *message, const serialized *bytes)
{
  count(entry->port, false);
  if (atomic_load_explicit(&entry->port->flags, memory_order_relaxed) & KEEPS)
    keep(entry, message, bytes);
}

static int published(struct entry *entry, struct pass *pass, int result)
{
  if (result == 0)
    count(entry->port, true);
  leave(pass);
  return result;
}

EXPORT int rcl_publish(const void *publisher, const void *message, void *allocation)
{
  struct entry *entry = find(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish()(publisher, message, allocation);
  if (!admitted(entry, &pass)) {
    held_back(entry, message, NULL);
    return 0;
  }
  return published(entry, &pass, real_rcl_publish()(publisher, message, allocation));
}

EXPORT int rcl_publish_serialized_message(const void *publisher, const void *message, void *allocation)
{
  struct entry *entry = find(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish_serialized_message()(publisher, message, allocation);
  if (!admitted(entry, &pass)) {
    held_back(entry, NULL, message);
    return 0;
  }
  return published(entry, &pass, real_rcl_publish_serialized_message()(publisher, message, allocation));
}

EXPORT int rcl_publish_loaned_message(const void *publisher, void *message, void *allocation)
{
  struct entry *entry = find(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish_loaned_message()(publisher, message, allocation);
  if (!admitted(entry, &pass)) {
    held_back(entry, message, NULL);
    return real_rcl_return_loaned_message_from_publisher()(publisher, message);
  }
  return published(entry, &pass, real_rcl_publish_loaned_message()(publisher, message, allocation));
}

/* The result of taking a message: where the gate is closed, as if there had been none. */
static int take_result(const void *subscription, int result)
{
  struct entry *entry = result == 0 ? find(subscription) : NULL;
  if (!entry)
    return result;
  bool open = atomic_load_explicit(&entry->port->gate, memory_order_acquire) == OPEN;
  if (open && atomic_load_explicit(&entry->port->flags, memory_order_acquire) & SHUT)
    open = now_ns() >= atomic_load(&page->head.lease);
  count(entry->port, open);
  return open ? 0 : TAKE_FAILED;
}

EXPORT int rcl_take(const void *subscription, void *message, void *info, void *allocation)
{
  return take_result(subscription, real_rcl_take()(subscription, message, info, allocation));
}

EXPORT int rcl_take_sequence(const void *subscription, size_t number, void *messages, void *infos, void *allocation)
{
  return take_result(subscription, real_rcl_take_sequence()(subscription, number, messages, infos, allocation));
}

EXPORT int rcl_take_serialized_message(const void *subscription, void *message, void *info, void *allocation)
{
  return take_result(subscription, real_rcl_take_serialized_message()(subscription, message, info, allocation));
}

EXPORT int rcl_take_loaned_message(const void *subscription, void **message, void *info, void *allocation)
{
  int result = take_result(subscription, real_rcl_take_loaned_message()(subscription, message, info, allocation));
  if (result == TAKE_FAILED && *message) {
    real_rcl_return_loaned_message_from_subscription()(subscription, *message);
    *message = NULL;
  }
  return result;
}

/* -- for the manager, and for tests ---------------------------------------------------------------------------------- */

EXPORT void midstride_layout(uint32_t *sizes)
{
  uint32_t layout[] = {PAGE_VERSION,        sizeof(struct page), sizeof(struct baton),
                       sizeof(struct node), sizeof(struct port), sizeof(struct requests)};
  memcpy(sizes, layout, sizeof layout);
}

EXPORT int midstride_enter(uint64_t word, unsigned index, unsigned flags, int waited, int collided, int dead,
                           uint64_t *next)
{
  return (int)baton_enter(word, index, flags, waited, collided, dead, next);
}

EXPORT uint64_t midstride_leave(uint64_t word, uint64_t entered, unsigned flags, int again)
{
  return baton_leave(word, entered, flags, again);
}

enum step { NAME_SUCCESSOR, WITHDRAW, SETTLE, FENCE, LIFT, GIVE, TAKE };

/* What a step of the manager makes of a word. `index`: of the holder; of the new one for GIVE and TAKE. */
EXPORT uint64_t midstride_step(uint64_t word, int step, unsigned index, unsigned successor, int at_once)
{
  switch ((enum step)step) {
  case NAME_SUCCESSOR:
    return baton_name(word, index, successor, at_once);
  case WITHDRAW:
    return baton_withdraw(word, index);
  case SETTLE:
    return baton_settle(word, index);
  case FENCE:
    return baton_fence(word, index);
  case LIFT:
    return baton_lift(word, index);
  case GIVE:
    return baton_give(word, index);
  case TAKE:
    return baton_take(word, index);
  }
  return word;
}

/* Take a step with the word of a baton in shared memory; returns the word before. */
EXPORT uint64_t midstride_take_step(struct baton *baton, int step, unsigned index, unsigned successor, int at_once)
{
  uint64_t seen = atomic_load(&baton->word), next;
  do {
    next = midstride_step(seen, step, index, successor, at_once);
    if (STATE(next) == OFFERED && STATE(seen) != OFFERED)
      atomic_store(&baton->offered, now_ns());
    if (SUCCESSOR(next) != SUCCESSOR(seen))
      atomic_store(&baton->collisions, 0);
  } while (!atomic_compare_exchange_weak(&baton->word, &seen, next));
  return seen;
}

EXPORT int midstride_is_dead(int file, unsigned index)
{
  return is_dead(file, index);
}

/* The page in `file`, for the manager; NULL where it has another layout. It stays for as long as the process lives. */
EXPORT struct page *midstride_map(int file)
{
  uint32_t version;
  return map_page(file, &version);
}

/* A port for the node `index`, as its index + 1; 0 where the page cannot grow. */
EXPORT unsigned midstride_claim(struct page *shared, int file, unsigned index)
{
  struct port *port = claim(shared, file, index + 1);
  return port ? (unsigned)(port - shared->ports) + 1 : 0;
}

/* The manager's steps with the requests of a role (number from 0); each returns the word after it. GIVE_REQUESTS: `node`
 * (index + 1) is to answer, and the one before has until `until` for what it has taken. */
enum requests_step { GIVE_REQUESTS, FORGET };

EXPORT uint64_t midstride_requests_step(struct page *shared, int file, unsigned number, int step, unsigned node,
                                        int64_t until)
{
  struct requests *requests = requests_at(shared, number);
  uint64_t word = atomic_load(&requests->word), next;
  if (step == GIVE_REQUESTS)
    atomic_store(&requests->until, until);
  do {
    unsigned now = ANSWERING(word);
    int lives = now && atomic_load(&shared->nodes[now - 1].pid) && !is_dead(file, now);
    next = step == GIVE_REQUESTS ? requests_give(word, node, lives) : requests_forget(word, node);
  } while (!atomic_compare_exchange_weak(&requests->word, &word, next));
  return next;
}

/* The same of a word; any other step is that of the node itself. */
EXPORT uint64_t midstride_requests_word(uint64_t word, int step, unsigned node, int lives)
{
  if (step == GIVE_REQUESTS)
    return requests_give(word, node, lives);
  return step == FORGET ? requests_forget(word, node) : requests_take_back(word, node);
}

/* What the steps of goals.h make of a word, and whose turn it is. RESERVE: `number` says whether the owner has ended. */
EXPORT uint64_t midstride_goal(uint64_t word, int reserve, unsigned node, int number)
{
  return reserve ? goal_reserve(word, node, number) : goal_step(word, node, (enum goal_event)number);
}

EXPORT int midstride_turn(int about, unsigned node, int own, unsigned owner, int in_flight, int added, int missing)
{
  return (int)turn_of((enum about)about, node, own, owner, in_flight, added, missing);
}

EXPORT int midstride_requests_claim(uint64_t word, uint32_t number, uint64_t *next)
{
  return requests_claim(word, number, next);
}

/* The part of a node in the page is free, and its ports are. */
EXPORT void midstride_free(struct page *shared, unsigned index)
{
  for (unsigned port = 0; port < atomic_load(&shared->head.room); port++)
    if (atomic_load(&shared->ports[port].node) == index + 1)
      free_port(&shared->ports[port]);
  unsigned number = atomic_load(&shared->nodes[index].requests);
  for (unsigned place = 0; number && number <= NODES && place < GOALS; place++) {
    struct goal *goal = &requests_at(shared, number - 1)->goals[place];
    if (OWNER(atomic_load(&goal->word)) == index + 1) /* the next process that is this node has none of its goals */
      atomic_store(&goal->word, atomic_load(&goal->word) >> 32 << 32);
  }
  atomic_store(&shared->nodes[index].requests, 0);
  atomic_store(&shared->nodes[index].used, 0);
}

EXPORT void midstride_ring(struct page *shared, unsigned index)
{
  unsigned process = shared->nodes[index].process;
  _Atomic uint32_t *bell = &shared->nodes[process ? process - 1 : index].bell;
  atomic_fetch_add(bell, 1);
  syscall(SYS_futex, (uint32_t *)bell, FUTEX_WAKE, INT_MAX, NULL, NULL, 0);
}

/* -- for a component with Midstride's API that hands over to such a node, or takes over from it ----------------------
 *
 * It joins a shared slot: the part of a node in the page, for the length of a hand-over. One thread publishes (begin, end). */

struct slot {
  struct page *page;
  int file;
  unsigned index;
  struct pass pass;
  unsigned count;
  struct {
    struct port *port;
    bool overdue;
  } outputs[];
};

EXPORT struct slot *midstride_join(const char *path, unsigned index)
{
  static struct page *shared;
  static int file = -1;
  static dev_t device;
  static ino_t inode;
  struct stat status;
  if (index >= NODES || stat(path, &status) != 0)
    return NULL;
  /* One open file for all slots: to close another one of the same page would release every lock of this process. */
  if (!shared || status.st_ino != inode || status.st_dev != device) {
    uint32_t version;
    int opened = open(path, O_RDWR | O_CLOEXEC);
    struct page *found = opened < 0 ? NULL : map_page(opened, &version);
    if (!found) {
      if (opened >= 0)
        close(opened);
      return NULL;
    }
    shared = found;
    file = opened;
    device = status.st_dev;
    inode = status.st_ino;
  }
  unsigned count = 0, room = atomic_load(&shared->head.room);
  for (unsigned port = 0; port < room; port++)
    count += atomic_load(&shared->ports[port].node) == index + 1;
  struct slot *slot = calloc(1, sizeof *slot + count * sizeof slot->outputs[0]);
  struct flock own = lock_of(index + 1, F_WRLCK);
  if (!slot || fcntl(file, F_SETLK, &own) != 0) {
    free(slot);
    return NULL;
  }
  slot->page = shared;
  slot->file = file;
  slot->index = index;
  slot->count = count;
  for (unsigned port = 0; port < room; port++)
    if (atomic_load(&shared->ports[port].node) == index + 1 && shared->ports[port].number < count)
      slot->outputs[shared->ports[port].number].port = &shared->ports[port];
  atomic_store(&shared->nodes[index].pid, (uint32_t)getpid());
  return slot;
}

/* The hand-over is over: its part in the page is free. */
EXPORT void midstride_leave_slot(struct slot *slot)
{
  struct flock own = lock_of(slot->index + 1, F_UNLCK);
  midstride_free(slot->page, slot->index);
  fcntl(slot->file, F_SETLK, &own);
  free(slot);
}

EXPORT int midstride_begin(struct slot *slot, unsigned port)
{
  return port < slot->count && slot->outputs[port].port &&
         enter(slot->page, slot->index + 1, slot->file, slot->outputs[port].port, &slot->outputs[port].overdue,
               &slot->pass);
}

EXPORT void midstride_end(struct slot *slot)
{
  leave(&slot->pass);
}

EXPORT struct baton *midstride_baton(struct slot *slot, unsigned number)
{
  return &slot->page->batons[number - 1];
}
