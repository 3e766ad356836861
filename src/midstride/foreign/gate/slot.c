/* For a component with Midstride's API that hands over to such a node, or takes over from it.
 *
 * It joins a shared slot: the part of a node in the page, for the length of a hand-over. One thread publishes (begin, end).
 */
#include "gate.h"

#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

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
