/* Requests of the manager to this node alone.
 *
 * The two nodes of a hand-over have one name, so a request by ROS reaches both. The manager puts one that is for this node
 * into a file instead, and counts it in the page; the executor of the node takes it like any other, and the response goes
 * into another file.
 */
#include "serving.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* By node, the number of the last request of the manager that was read. With `lock` */
static uint32_t taken_asked[NODES];

/* The name of the file of the request `number` to the node `own` (index + 1), or, by its `suffix`, of another one of it. */
static void asked_file(char *name, unsigned own, uint32_t number, const char *suffix)
{
  snprintf(name, FILE_NAME, "%s.%u.%u%s", page_path, own - 1, number, suffix);
}

/* The server of the node `own` (index + 1) with that name; NULL where there is none. With `lock`. */
static struct entry *server_of(unsigned own, const char *name)
{
  for (struct table *table = &first_table; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++) {
      struct entry *entry = &table->entries[index];
      const void *endpoint = atomic_load(&entry->endpoint);
      if (endpoint && endpoint != REMOVED && entry->me == own && entry->kind == SERVER &&
          strncmp(entry->port->topic, name, NAME) == 0)
        return entry;
    }
  return NULL;
}

uint8_t *read_file(const char *name, size_t *length)
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
static void hold_asked(unsigned own, uint32_t number)
{
  char name[FILE_NAME];
  size_t length;
  asked_file(name, own, number, "");
  uint8_t *bytes = read_file(name, &length);
  if (!bytes)
    return;
  size_t begin = strlen((char *)bytes) + 1;
  struct entry *entry = begin <= length ? server_of(own, (char *)bytes) : NULL;
  struct held *held = entry ? calloc(1, sizeof *held) : NULL;
  if (!held) {
    free(bytes);
    return;
  }
  memmove(bytes, bytes + begin, length - begin);
  held->bytes.buffer = bytes;
  held->bytes.length = length - begin;
  held->bytes.capacity = length + 1;
  held->bytes.memory = heap;
  memcpy(held->info.id.client, MANAGER, sizeof MANAGER);
  held->info.id.number = number;
  held->at = now_ns();
  hold_claimed(entry, held);
}

void forget_asked(unsigned own)
{
  taken_asked[own - 1] = 0;
}

void take_asked(void)
{
  unsigned process = (unsigned)(node - page->nodes) + 1;
  for (unsigned index = 0; index < NODES; index++) {
    struct node *asked = &page->nodes[index];
    if (asked != node && (!atomic_load(&asked->used) || asked->process != process))
      continue;
    for (uint32_t last = atomic_load(&asked->asked); taken_asked[index] != last;)
      hold_asked(index + 1, ++taken_asked[index]);
  }
}

int respond(const struct entry *entry, const struct request_id *id, const void *response)
{
  char name[FILE_NAME], partial[FILE_NAME];
  serialized bytes = {.memory = heap};
  int result = real_rmw_serialize()(response, entry->response, &bytes);
  if (result == 0) {
    asked_file(name, entry->me, (uint32_t)id->number, ".answer");
    asked_file(partial, entry->me, (uint32_t)id->number, ".partial");
    int file = open(partial, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (file >= 0 && write(file, bytes.buffer, bytes.length) == (ssize_t)bytes.length)
      rename(partial, name);
    if (file >= 0)
      close(file);
  }
  free(bytes.buffer);
  return result;
}
