/* The requests by which other programs set parameters of a node, noted for the manager in a file beside the page.
 *
 * Each is there with when it was taken, and in the bytes that the middleware would send: the manager knows the type. It also
 * knows how many there have been, from the page, and so whether one is not in the file.
 */
#include "serving.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

/* How many bytes such a file has at most. */
#define MOST_NOTED (1 << 20)

static pthread_mutex_t noting = PTHREAD_MUTEX_INITIALIZER; /* of such a file */

static bool sets_parameters(const char *service)
{
  const char *name = strrchr(service, '/');
  return name && (strcmp(name, "/set_parameters") == 0 || strcmp(name, "/set_parameters_atomically") == 0);
}

/* Append it as a whole: when it was taken (Unix time, ns), how many bytes follow, the name of the service with a 0, and the
 * request. */
static void append_setting(const struct entry *entry, const serialized *bytes)
{
  char name[FILE_NAME];
  struct timespec at;
  struct stat status;
  clock_gettime(CLOCK_REALTIME, &at);
  size_t service = strlen(entry->port->topic) + 1;
  struct {
    int64_t at;
    uint64_t length;
  } head = {at.tv_sec * INT64_C(1000000000) + at.tv_nsec, service + bytes->length};
  struct iovec parts[] = {{&head, sizeof head}, {entry->port->topic, service}, {bytes->buffer, bytes->length}};
  snprintf(name, FILE_NAME, "%s.%u.settings", page_path, entry->me - 1);
  int file = open(name, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (file < 0)
    return;
  size_t length = sizeof head + head.length;
  pthread_mutex_lock(&noting);
  /* What is not there is not known, and counts as such; a part of one would hide all that follow. */
  if (fstat(file, &status) == 0 && (size_t)status.st_size + length <= MOST_NOTED &&
      writev(file, parts, 3) != (ssize_t)length && ftruncate(file, status.st_size) != 0)
    unlink(name);
  pthread_mutex_unlock(&noting);
  close(file);
}

void note_setting(const struct entry *entry, const void *request)
{
  if (entry->service != OTHER || !sets_parameters(entry->port->topic))
    return;
  serialized bytes = {.memory = heap};
  if (real_rmw_serialize()(request, entry->type, &bytes) == 0)
    append_setting(entry, &bytes);
  else
    real_rcutils_reset_error()();
  free(bytes.buffer);
}
