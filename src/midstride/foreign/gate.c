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

/* The real functions, each found when it is first called: librcl may be loaded after this library. */
static void *real(_Atomic(void *) *known, const char *name)
{
  void *found = atomic_load_explicit(known, memory_order_acquire);
  if (found)
    return found;
  found = dlsym(RTLD_NEXT, name);
  if (!found) { /* loaded by an extension module of Python, so not in the global scope */
    /* What it is linked with is searched, too: the functions of the middleware are in a library of another name on each
     * installation. */
    void *handle = dlopen("librcl.so", RTLD_NOW | RTLD_NOLOAD);
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
REAL(int, rmw_serialize, const void *, const void *, void *)
REAL(void, rcutils_reset_error, void)

/* -- the page ------------------------------------------------------------------------------------------------------- */

/* A message that was written behind the gate. */
struct kept {
  struct kept *next;
  serialized bytes;
};

/* A publisher or subscription of this process whose topic is in the page. */
struct entry {
  _Atomic(const void *) endpoint; /* NULL: free; REMOVED: removed */
  struct port *port;
  unsigned me; /* index + 1 of the node that has it */
  unsigned used; /* index of the port among `used_ports` */
  const void *type;
  bool overdue; /* see `enter` */
  struct kept *kept, **kept_end; /* the last messages that were written behind the gate, the oldest first */
  unsigned keeping, most_kept;   /* how many there are, and may be */
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
static int descriptor = -1;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* of the tables where they change, and of what is kept */
static pthread_t helper;
static bool helping, stopping;
/* The ports that this process has had endpoints of. With `lock`. */
static struct used_port {
  struct port *port;
  unsigned me;
  uint32_t matched;
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
  struct page *found = mmap(NULL, length_with(MOST_PORTS), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  return found == MAP_FAILED ? NULL : found;
}

__attribute__((constructor)) static void join(void)
{
  const char *path = getenv(ENV_PAGE), *index = getenv(ENV_NODE);
  if (!path || !index)
    return;
  char *end;
  unsigned long number = strtoul(index, &end, 10);
  if (end == index || *end || number >= NODES)
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

static void *help(void *);

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

/* The port of the node `me` with that topic; NULL where there is none. With `lock`. */
static struct port *port_of(unsigned me, const char *topic, uint32_t kind)
{
  uint32_t number = 0;
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++) {
    struct port *port = &page->ports[index];
    if (atomic_load(&port->node) != me || atomic_load(&port->kind) == NODE)
      continue;
    if (atomic_load(&port->kind) == kind && strncmp(port->topic, topic, NAME) == 0)
      return port;
    number++;
  }
  struct port *port = listed(me, topic) ? claim(page, descriptor, me) : NULL;
  if (port) {
    strcpy(port->topic, topic);
    port->number = number;
    port->gate = OPEN;
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

/* Where `topic` is a port of this node, remember the endpoint, and have the helper thread run. False where there is no
 * memory for that: the endpoint would have no gate. */
static bool add(const void *endpoint, const void *owner, const char *topic, uint32_t kind, const void *type)
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
  atomic_store_explicit(&entry->endpoint, endpoint, memory_order_release);
  atomic_fetch_add(&port->endpoints, 1);
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

static void forget(const void *endpoint)
{
  struct entry *entry = find(endpoint);
  if (!entry)
    return;
  pthread_mutex_lock(&lock);
  atomic_store_explicit(&entry->endpoint, REMOVED, memory_order_release);
  atomic_fetch_sub(&entry->port->endpoints, 1);
  atomic_store(&entry->port->kept, 0);
  discard(entry, 0);
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

/* Publish what is kept, in its order, if it may be published now. With `lock`. */
static void publish_kept(struct entry *entry)
{
  struct pass pass;
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
  for (unsigned index = 0; index < used_count; index++)
    used_ports[index].matched = 0;
  for (struct table *table = &first; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++)
      look_at(&table->entries[index]);
  for (unsigned index = 0; index < used_count; index++)
    if (atomic_load(&used_ports[index].port->node) == used_ports[index].me)
      atomic_store(&used_ports[index].port->matched, used_ports[index].matched);
}

/* Before what the middleware keeps is destroyed: it was loaded before this was registered. */
static void stop_helping(void)
{
  pthread_mutex_lock(&lock);
  stopping = true;
  pthread_mutex_unlock(&lock);
}

static void *help(void *unused)
{
  (void)unused;
  atexit(stop_helping);
  for (;;) {
    uint32_t seen = atomic_load(&node->bell);
    pthread_mutex_lock(&lock);
    if (stopping) {
      pthread_mutex_unlock(&lock);
      return NULL;
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

EXPORT int rcl_publisher_init(void *publisher, const void *owner, const void *type, const char *name, const void *options)
{
  int result = real_rcl_publisher_init()(publisher, owner, type, name, options);
  if (page && result == 0 && !add(publisher, owner, real_rcl_publisher_get_topic_name()(publisher), OUTPUT, type)) {
    real_rcl_publisher_fini()(publisher, (void *)owner);
    return BAD_ALLOC;
  }
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
      !add(subscription, owner, real_rcl_subscription_get_topic_name()(subscription), INPUT, type)) {
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
  uint32_t layout[] = {PAGE_VERSION, sizeof(struct page), sizeof(struct baton), sizeof(struct node), sizeof(struct port)};
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

/* The part of a node in the page is free, and its ports are. */
EXPORT void midstride_free(struct page *shared, unsigned index)
{
  for (unsigned port = 0; port < atomic_load(&shared->head.room); port++)
    if (atomic_load(&shared->ports[port].node) == index + 1)
      free_port(&shared->ports[port]);
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
