/* Servers: what is taken, and what is answered. */
#include "serving.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* How many requests a server's queue has room for at least. Of a shallower one, requests fall out while a busy executor
 * does not take them, as while a node starts. */
#define QUEUE 200u

/* The types of the messages of a service, where its requests can be held: copied, and given back later. */
static struct message_types copied_types(const struct service_type *type)
{
  struct message_types none = {NULL, NULL};
  bool can_copy = real_rmw_serialize() && real_rmw_deserialize() && real_rcutils_reset_error();
  return type && can_copy ? message_types(type) : none;
}

/* The result of initializing a server, of which the messages have these types. */
static int listed(int result, void *service, const void *owner, const struct message_types *types)
{
  if (result == 0 && !add_entry(server_key(service), owner, real_rcl_service_get_service_name()(service), SERVER,
                                types->request, types->response)) {
    real_rcl_service_fini()(service, (void *)owner);
    return BAD_ALLOC;
  }
  return result;
}

EXPORT int rcl_service_init(void *service, const void *owner, const void *type, const char *name,
                            const struct service_options *options)
{
  struct message_types types = copied_types(page ? type : NULL);
  if (!types.request || !options)
    return real_rcl_service_init()(service, owner, type, name, options);
  struct service_options deeper = *options;
  if (deeper.history == KEEP_LAST && deeper.depth < QUEUE)
    deeper.depth = QUEUE;
  return listed(real_rcl_service_init()(service, owner, type, name, &deeper), service, owner, &types);
}

/* librcl initializes this server itself (from Jazzy on): where it is linked with -Bsymbolic-functions, the function above is
 * not called. In Iron, this function had another form; there librcl also had one that ends the server. */
EXPORT int rcl_node_type_description_service_init(void *service, const void *owner)
{
  int result = real_rcl_node_type_description_service_init()(service, owner);
  bool unseen = page && result == 0 && !real_rcl_node_type_description_service_fini() && !find_server(service);
  struct message_types types = copied_types(unseen && real_type_description() ? real_type_description()() : NULL);
  return types.request ? listed(result, service, owner, &types) : result;
}

EXPORT int rcl_service_fini(void *service, void *owner)
{
  if (server_key(service))
    remove_entry(server_key(service));
  return real_rcl_service_fini()(service, owner);
}

EXPORT int rcl_service_set_on_new_request_callback(const void *service, void (*callback)(const void *, size_t),
                                                   const void *context)
{
  struct entry *entry = find_server(service);
  if (entry) {
    pthread_mutex_lock(&lock);
    entry->callback = callback;
    entry->context = context;
    atomic_store(&entry->port->busy, 0); /* which is known of executors that wait */
    pthread_mutex_unlock(&lock);
  }
  return real_rcl_service_set_on_new_request_callback()(service, callback, context);
}

/* Take a request for the node of `entry`, or one that was held; it holds those that come while it leaves. */
static int take_for(struct entry *entry, const void *service, struct request_info *info, void *request)
{
  struct requests *requests = requests_of(entry->me);
  bool leaves = has_to_leave(entry->me);
  if (!leaves && requests && take_held(entry, requests, info, request))
    return 0;
  int result = real_rcl_take_request_with_info()(service, info, request);
  if (result != 0)
    return result;
  begin_loading(entry->port->topic);
  if (!requests)
    return leaves ? NO_REQUEST : 0;
  note_seen(requests, entry->me, &info->id);
  struct subject subject = subject_of(entry, request);
  if (leaves) {
    hold_request(entry, info, request, &subject, false);
    return NO_REQUEST;
  }
  struct taken *taken = NULL;
  int64_t came = arrival(info);
  switch (turn_with(requests, entry, &subject, &info->id, now_ns(), false, answers(requests, entry))) {
  case ANSWER:
    if (is_lost(requests, came) || !begin_request(requests, entry, info, &subject, came, &taken))
      return NO_REQUEST;
    remember(entry, taken);
    note_setting(entry, request);
    return 0;
  case ADD:
    if (!claim_request(requests, info, true) || !(taken = calloc(1, sizeof *taken)))
      return NO_REQUEST;
    *taken = (struct taken){.id = info->id, .subject = subject, .adds = true};
    hold_request(entry, info, request, &subject, true);
    remember(entry, taken);
    return 0;
  case WAIT:
    hold_request(entry, info, request, &subject, false);
  }
  pthread_mutex_lock(&lock);
  if (is_due(entry)) /* since meanwhile it is to answer */
    announce(entry);
  pthread_mutex_unlock(&lock);
  return NO_REQUEST;
}

static int take_request(const void *service, struct request_info *info, void *request)
{
  struct entry *entry = find_server(service);
  end_input();
  begin_call(entry ? entry->me : 0);
  int result = entry ? take_for(entry, service, info, request)
                     : real_rcl_take_request_with_info()(service, info, request);
  if (result != 0)
    begin_call(0);
  return result;
}

EXPORT int rcl_take_request_with_info(const void *service, struct request_info *info, void *request)
{
  return take_request(service, info, request);
}

/* In librcl, too, it is the same without the times. But a call within librcl does not reach this library where that is linked
 * with -Bsymbolic-functions, as packages for Ubuntu are by default; and the times are needed. */
EXPORT int rcl_take_request(const void *service, struct request_id *id, void *request)
{
  struct request_info info = {.id = *id};
  int result = take_request(service, &info, request);
  *id = info.id;
  return result;
}

/* Have the node that answers look at once. */
void ring_others(const struct entry *entry)
{
  uint64_t word = atomic_load(&requests_of(entry->me)->word);
  if (ANSWERING(word) && ANSWERING(word) != entry->me)
    midstride_ring(page, ANSWERING(word) - 1);
}

/* Of action_msgs/srv/CancelGoal. */
enum { UNKNOWN_GOAL_ID = 2 };

/* Answer with the result of a goal whose node has ended, if the manager has kept it in a file: no client had fetched it.
 * Whether it has. */
static bool answer_kept(const struct entry *entry, const uint8_t *goal, void *response)
{
  char name[FILE_NAME];
  int end = snprintf(name, FILE_NAME, "%s.result.", page_path);
  for (unsigned index = 0; index < 16; index++)
    end += snprintf(name + end, FILE_NAME - (size_t)end, "%02x", goal[index]);
  serialized bytes = {.memory = heap};
  bytes.buffer = entry->response ? read_file(name, &bytes.length) : NULL;
  bytes.capacity = bytes.length + 1;
  bool known = bytes.buffer && real_rmw_deserialize()(&bytes, entry->response, response) == 0;
  if (bytes.buffer && !known)
    real_rcutils_reset_error()();
  free(bytes.buffer);
  return known;
}

EXPORT int rcl_send_response(const void *service, struct request_id *id, void *response)
{
  struct entry *entry = find_server(service);
  if (entry)
    end_loading(entry->port->topic);
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
    if (begins)
      count_goal(entry->me, GOALS_ACCEPTED);
  }
  bool unknown = taken && entry->service == CANCEL_GOAL && begins == UNKNOWN_GOAL_ID;
  if (taken && entry->service == GET_RESULT && !begins) /* the node does not know the goal */
    unknown = !answer_kept(entry, taken->subject.goal, response);
  if (unknown)
    count_goal(entry->me, GOALS_UNKNOWN);
  int result = real_rcl_send_response()(service, id, response);
  bool fetched = result == 0 && taken && entry->service == GET_RESULT && begins;
  if (fetched && !step_beyond(taken->subject.goal, FETCH)) {
    struct goal *goal = find_goal(requests, taken->subject.goal);
    if (goal)
      step_goal(goal, entry->me, FETCH);
  }
  free(taken);
  answered(entry, requests, id, true);
  return result;
}
