/* One request that cancels many goals, of which two nodes have some: each cancels its own, and one answers for both. */
#include "serving.h"

#include <stdlib.h>
#include <string.h>

struct added *find_added(struct requests *requests, unsigned index, const struct request_id *id)
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

/* A response to a request to cancel goals, as bytes: 4 that say how they are ordered, the code, 3 unused, the number of
 * goals in 4, and the goals. */
#define CODE 4
#define NUMBER 8
#define FIRST_GOAL 12

/* Its bytes; false where they are not those of such a response. */
static bool read_cancelled(struct entry *entry, const void *response, serialized *bytes, uint32_t *count)
{
  *bytes = (serialized){.memory = heap};
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

void leave_added(struct requests *requests, struct entry *entry, const struct taken *taken, const void *response)
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

void merge_added(struct requests *requests, struct entry *entry, const struct taken *taken, void *response)
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

void cancel_all(struct entry *entry)
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
  held->bytes.memory = heap;
  held->bytes.buffer[1] = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__; /* no goal, no time: all of them */
  held->info.id.number = -1;
  held->taken->id = held->info.id;
  held->taken->subject.about = ABOUT_MANY;
  held->taken->own = true;
  hold_claimed(entry, held);
  entry->cancelled = true;
}
