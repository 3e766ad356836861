/* What a node takes from a topic while a change is measured: when, and what the middleware says of each message. */
#include "serving.h"

#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

/* The file of the port of `entry`, which the manager has made beside the page; NULL where there is none. It stays mapped, as
 * other threads may be writing to it. */
static struct receipts *map_receipts(struct entry *entry)
{
  char name[FILE_NAME];
  snprintf(name, sizeof name, "%s.%u.receipts.%u", page_path, entry->me - 1, entry->port->number);
  int file = open(name, O_RDWR | O_CLOEXEC);
  struct stat status;
  struct receipts *found = NULL;
  if (file >= 0 && fstat(file, &status) == 0 && status.st_size >= (off_t)sizeof *found) {
    void *mapped = mmap(NULL, sizeof *found, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    found = mapped == MAP_FAILED ? NULL : mapped;
  }
  if (file >= 0)
    close(file);
  return found;
}

void note_receipt(struct entry *entry, const struct message_info *info, const uint8_t writer[16])
{
  if (!atomic_load_explicit(&entry->port->recorded, memory_order_acquire))
    return;
  struct receipts *receipts = atomic_load_explicit(&entry->receipts, memory_order_acquire);
  if (!receipts) {
    pthread_mutex_lock(&lock);
    receipts = atomic_load(&entry->receipts);
    if (!receipts)
      atomic_store_explicit(&entry->receipts, receipts = map_receipts(entry), memory_order_release);
    pthread_mutex_unlock(&lock);
    if (!receipts)
      return; /* the manager sees that fewer are noted than were taken */
  }
  uint64_t place = atomic_fetch_add(&receipts->count, 1);
  struct receipt *receipt = &receipts->last[place % RECEIPTS];
  atomic_store_explicit(&receipt->place, 0, memory_order_relaxed);
  atomic_thread_fence(memory_order_release);
  receipt->received = now_ns();
  receipt->sent = info->sent;
  receipt->number = info->number == UNNUMBERED ? 0 : info->number;
  memcpy(receipt->writer, writer, sizeof receipt->writer);
  atomic_store_explicit(&receipt->place, place + 1, memory_order_release);
}
