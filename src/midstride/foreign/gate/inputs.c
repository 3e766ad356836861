/* Which message each thread answers, and whether the outputs of a node answer each message once: answers.h has the rule. */
#include "serving.h"

#include <string.h>

static pthread_mutex_t answered_lock = PTHREAD_MUTEX_INITIALIZER; /* of this process, where a part in the page is taken */

/* What this thread has taken last, until it does something else. */
static _Thread_local struct {
  struct entry *source; /* NULL: nothing */
  const void *endpoint;
  struct input input;
  bool open; /* an output is still to answer it */
  unsigned count;
  struct port *answers[MOST_OUTPUTS]; /* the outputs that have answered it */
} current;

uint64_t mixed(uint64_t key, uint64_t bits) /* SplitMix64 */
{
  key += bits + UINT64_C(0x9e3779b97f4a7c15);
  key = (key ^ key >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
  key = (key ^ key >> 27) * UINT64_C(0x94d049bb133111eb);
  return key ^ key >> 31;
}

uint64_t key_of(const void *bytes, size_t length)
{
  uint64_t key = 0;
  for (size_t begin = 0; begin < length; begin += sizeof(uint64_t)) {
    uint64_t part = 0;
    memcpy(&part, (const char *)bytes + begin, length - begin < sizeof part ? length - begin : sizeof part);
    key = mixed(key, part);
  }
  return key ? key : 1;
}

static void add_bits(_Atomic uint64_t *bits, uint64_t more)
{
  if (more & ~atomic_load_explicit(bits, memory_order_relaxed))
    atomic_fetch_or(bits, more);
}

/* -- whether each input is answered once ------------------------------------------------------------------------------ */

static void out_of_step(struct port *output)
{
  if (atomic_load_explicit(&output->in_step, memory_order_relaxed)) {
    atomic_store(&output->in_step, 0);
    atomic_store(&output->answers, 0);
    atomic_fetch_add(&output->falls, 1);
  }
}

static struct port *output_of(struct entry *source, unsigned index)
{
  return index < MOST_OUTPUTS ? atomic_load_explicit(&source->outputs[index], memory_order_acquire) : NULL;
}

static bool has_answered(const struct port *output)
{
  for (unsigned index = 0; index < current.count; index++)
    if (current.answers[index] == output)
      return true;
  return false;
}

static void close_input(void)
{
  if (current.open) { /* another subscription may have been created at this address, and has none then */
    uint32_t open = atomic_load(&current.source->open);
    while (open && !atomic_compare_exchange_weak(&current.source->open, &open, open - 1))
      ;
  }
  current.open = false;
}

void end_input(void)
{
  struct entry *source = current.source;
  begin_call(0);
  if (!source)
    return;
  if (atomic_load(&source->endpoint) == current.endpoint) {
    struct port *output;
    for (unsigned index = 0; (output = output_of(source, index)); index++)
      if (!has_answered(output))
        out_of_step(output);
    close_input();
  }
  current.source = NULL;
}

void begin_input(struct entry *source, const struct message_info *info, const uint8_t writer[16])
{
  if (source->kind != INPUT)
    return;
  bool timed = !info->number || info->number == UNNUMBERED;
  current.source = source;
  current.endpoint = atomic_load(&source->endpoint);
  current.input = (struct input){
      .topic = UINT64_C(1) << source->key % 64,
      .writer = key_of(writer, sizeof info->writer),
      .number = timed ? (uint64_t)info->sent : info->number,
      .timed = timed,
  };
  current.count = 0;
  current.open = true;
  struct port *output;
  /* While another thread has one that is not answered, the later one may be answered before it. */
  bool alone = atomic_fetch_add(&source->open, 1) == 0;
  for (unsigned index = 0; !alone && (output = output_of(source, index)); index++)
    out_of_step(output);
}

/* An output answers what this thread has taken; false where it cannot be noted. */
static bool join_outputs(struct port *output)
{
  unsigned known = 0;
  bool found = false;
  if (current.count == MOST_OUTPUTS) /* of a subscription that has been created anew: the outputs of both */
    return false;
  for (; known < MOST_OUTPUTS; known++) {
    struct port *other = NULL;
    if (atomic_compare_exchange_strong(&current.source->outputs[known], &other, output) || other == output) {
      found = true;
      break;
    }
  }
  if (!found)
    return false;
  current.answers[current.count++] = output;
  for (known = 0; output_of(current.source, known); known++)
    ;
  if (current.count == known)
    close_input();
  return true;
}

/* -- the last answers in the page ------------------------------------------------------------------------------------- */

/* The part of an output and a writer; NULL where there is none. */
static struct answered *find_answered(struct requests *requests, uint64_t id)
{
  for (unsigned step = 0; step < ANSWERED; step++) {
    struct answered *answered = &requests->answered[(id + step) % ANSWERED];
    uint64_t known = atomic_load_explicit(&answered->id, memory_order_acquire);
    if (known == id)
      return answered;
    if (!known)
      return NULL;
  }
  return NULL;
}

/* A part for an output and a writer; where all are used, that of the one which has been silent for longest. */
static struct answered *answered_for(struct requests *requests, uint64_t id)
{
  struct answered *found = find_answered(requests, id);
  if (found)
    return found;
  pthread_mutex_lock(&answered_lock);
  lock_places(requests, OF_ANSWERS, F_WRLCK);
  found = find_answered(requests, id);
  for (unsigned step = 0; !found && step < ANSWERED; step++) {
    struct answered *answered = &requests->answered[(id + step) % ANSWERED];
    if (!atomic_load(&answered->id))
      found = answered;
  }
  if (!found) {
    found = &requests->answered[0];
    for (unsigned place = 1; place < ANSWERED; place++)
      if (atomic_load(&requests->answered[place].at) < atomic_load(&found->at))
        found = &requests->answered[place];
  }
  if (atomic_load(&found->id) != id) {
    atomic_store(&found->number, 0);
    atomic_store(&found->by, 0);
    atomic_store(&found->at, now_ns()); /* else it would be the next one to be taken */
    atomic_store_explicit(&found->id, id, memory_order_release);
  }
  lock_places(requests, OF_ANSWERS, F_UNLCK);
  pthread_mutex_unlock(&answered_lock);
  return found;
}

static uint64_t id_of(const struct entry *output, const struct input *input)
{
  uint64_t id = mixed(output->key, input->writer);
  return id ? id : 1;
}

static struct answered *last_answer(const struct entry *output, const struct input *input)
{
  struct requests *requests = input->number ? requests_of(output->me) : NULL;
  return requests ? find_answered(requests, id_of(output, input)) : NULL;
}

bool another_answers(const struct entry *output, const struct input *input)
{
  struct answered *answered = last_answer(output, input);
  unsigned by = answered ? atomic_load(&answered->by) : 0;
  return by && by != output->me;
}

bool is_answered(const struct entry *output, const struct input *input)
{
  struct answered *answered = last_answer(output, input);
  if (!answered || answers_may(input->number, input->timed, atomic_load(&answered->number), atomic_load(&answered->by),
                               output->me))
    return false;
  add_bits(&output->port->overlaps, input->topic);
  return true;
}

void note_answer(const struct entry *output, const struct input *input)
{
  struct requests *requests = input->number ? requests_of(output->me) : NULL;
  if (!requests)
    return;
  struct answered *answered = answered_for(requests, id_of(output, input));
  uint64_t last = atomic_load(&answered->number);
  if (last >= input->number && atomic_load(&answered->by) == output->me)
    out_of_step(output->port); /* the later one was answered before it */
  while (answers_may(input->number, input->timed, last, 0, output->me) &&
         !atomic_compare_exchange_weak(&answered->number, &last, input->number))
    ;
  atomic_store(&answered->by, output->me);
  atomic_store_explicit(&answered->at, now_ns(), memory_order_relaxed);
}

struct input answered_by(struct entry *output)
{
  struct port *port = output->port;
  struct entry *source = current.source;
  bool own = source && source->me == output->me && atomic_load(&source->endpoint) == current.endpoint;
  if (!own || output->latched || !current.input.number || has_answered(port) || !join_outputs(port)) {
    out_of_step(port);
    return (struct input){0};
  }
  add_bits(&port->answers, current.input.topic);
  atomic_fetch_add_explicit(&port->in_step, 1, memory_order_relaxed);
  return current.input;
}
