/* The page of shared memory, and the locks that say which processes live. */
#include "gate.h"

#include <errno.h>
#include <limits.h>
#include <linux/futex.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

/* For how long a request may still be held that a component has claimed, which shares the role no longer (ns). */
#define LATE INT64_C(10000000000)

static size_t length_with(unsigned ports)
{
  return sizeof(struct page) + ports * sizeof(struct port);
}

struct requests *requests_at(struct page *shared, unsigned number)
{
  return (struct requests *)((char *)shared + length_with(MOST_PORTS)) + number;
}

struct page *map_page(int file, uint32_t *version)
{
  struct head head;
  struct stat status;
  *version = 0;
  if (pread(file, &head, sizeof head, 0) != sizeof head || head.magic != PAGE_MAGIC)
    return NULL;
  *version = head.version;
  if (head.version < PAGE_OLDEST || head.version > PAGE_VERSION || head.size != sizeof(struct page) ||
      head.node_size != sizeof(struct node) || head.port_size != sizeof(struct port) || fstat(file, &status) != 0 ||
      status.st_size < (off_t)length_with(head.room))
    return NULL;
  size_t most = length_with(MOST_PORTS) + NODES * sizeof(struct requests);
  struct page *found = mmap(NULL, most, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  return found == MAP_FAILED ? NULL : found;
}

struct flock lock_of(unsigned index, short type)
{
  return (struct flock){.l_type = type, .l_whence = SEEK_SET, .l_start = index - 1, .l_len = 1};
}

int is_dead(int file, unsigned index)
{
  struct flock held = lock_of(index, F_WRLCK);
  return fcntl(file, F_GETLK, &held) == 0 && held.l_type == F_UNLCK;
}

void free_port(struct port *port)
{
  atomic_store(&port->kind, UNUSED);
  atomic_store(&port->node, 0);
}

struct port *reserve_port(struct page *shared, int file, unsigned own)
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
  for (unsigned place = 0; number && number <= NODES && place < ANSWERED; place++) {
    struct answered *answered = &requests_at(shared, number - 1)->answered[place];
    if (atomic_load(&answered->by) == index + 1) /* nor has it given its answers */
      atomic_store(&answered->by, 0);
  }
  if (number && number <= NODES && atomic_load(&shared->nodes[index].used) & HAS_AGENT)
    atomic_store(&requests_at(shared, number - 1)->mixed, now_ns() + LATE);
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
