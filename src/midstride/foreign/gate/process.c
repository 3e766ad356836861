/* This process in the page: which node it was started as, and the helper thread, which publishes what is kept and counts
 * with how many endpoints each port is matched. */
#include "serving.h"

#include <fcntl.h>
#include <linux/futex.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

#define ENV_PAGE "MIDSTRIDE_GATE_PAGE"
#define ENV_NODE "MIDSTRIDE_GATE_NODE"

struct page *page;
struct node *node;
char page_path[PATH_MAX];
int descriptor = -1;
pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_t helper;
static bool helping, stopping;

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
            "midstride: this process has no gate: %s has layout %u, and %d to %d can be used; end it by `midstride down` of "
            "the version that started it\n",
            path, version, PAGE_OLDEST, PAGE_VERSION);
    return;
  }
  descriptor = file;
  node = &page->nodes[number];
  strcpy(page_path, path);
}

static void wait_for_bell(_Atomic uint32_t *bell, uint32_t seen)
{
  struct timespec timeout = {0, LOOK};
  syscall(SYS_futex, (uint32_t *)bell, FUTEX_WAIT, seen, &timeout, NULL, 0);
}

static void look_at(struct entry *entry)
{
  const void *endpoint = atomic_load(&entry->endpoint);
  if (!endpoint || endpoint == REMOVED || atomic_load(&entry->port->node) != entry->me)
    return;
  if (entry->kind == SERVER) {
    look_at_server(entry);
    return;
  }
  bool output = entry->kind == OUTPUT;
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
  place_beyond();
  for (unsigned index = 0; index < used_count; index++)
    used_ports[index].matched = used_ports[index].waiting = 0;
  for (struct table *table = &first_table; table; table = atomic_load(&table->next))
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

void keep_helping(void)
{
  stop_at_exit();
  if (helping)
    return;
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before); /* signals are for the threads of the node */
  helping = pthread_create(&helper, NULL, help, NULL) == 0;
  pthread_sigmask(SIG_SETMASK, &before, NULL);
}
