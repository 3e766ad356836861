/* Subscriptions: a message that is taken while the gate of its port is closed, or its node leaves, is dropped. */
#include "gate.h"

EXPORT int rcl_subscription_init(void *subscription, const void *owner, const void *type, const char *name,
                                 const void *options)
{
  int result = real_rcl_subscription_init()(subscription, owner, type, name, options);
  if (page && result == 0 &&
      !add_entry(subscription, owner, real_rcl_subscription_get_topic_name()(subscription), INPUT, type, NULL)) {
    real_rcl_subscription_fini()(subscription, (void *)owner);
    return BAD_ALLOC;
  }
  if (page && result == 0 && !find_entry(subscription))
    note_caller(subscription, owner);
  return result;
}

EXPORT int rcl_subscription_fini(void *subscription, void *owner)
{
  remove_entry(subscription);
  forget_caller(subscription);
  return real_rcl_subscription_fini()(subscription, owner);
}

/* The result of taking a message, which `info` is about: where the gate is closed, as if there had been none. NULL: it is not
 * one message. */
static int take_result(const void *subscription, int result, const struct message_info *info)
{
  struct entry *entry = result == 0 ? find_entry(subscription) : NULL;
  unsigned me = entry ? entry->me : result == 0 ? called_by(subscription) : 0;
  begin_call(me);
  bool open = !has_to_leave(me);
  if (entry)
    open = open && atomic_load_explicit(&entry->port->gate, memory_order_acquire) == OPEN;
  if (open && entry && atomic_load_explicit(&entry->port->flags, memory_order_acquire) & SHUT)
    open = now_ns() >= atomic_load(&page->head.lease);
  if (!open)
    begin_call(0);
  if (!entry)
    return open ? result : TAKE_FAILED;
  uint8_t writer[sizeof info->writer];
  if (info) {
    writer_identity(subscription, info, writer);
    note_receipt(entry, info, writer); /* before it is counted: fewer that are noted show that some are not */
  }
  count_call(entry->port, open);
  if (open && info)
    begin_input(entry, info, writer);
  return open ? 0 : TAKE_FAILED;
}

EXPORT int rcl_take(const void *subscription, void *message, struct message_info *info, void *allocation)
{
  struct message_info own = {0};
  end_input();
  info = info ? info : &own;
  return take_result(subscription, real_rcl_take()(subscription, message, info, allocation), info);
}

EXPORT int rcl_take_sequence(const void *subscription, size_t number, void *messages, void *infos, void *allocation)
{
  end_input();
  return take_result(subscription, real_rcl_take_sequence()(subscription, number, messages, infos, allocation), NULL);
}

EXPORT int rcl_take_serialized_message(const void *subscription, void *message, struct message_info *info,
                                       void *allocation)
{
  struct message_info own = {0};
  end_input();
  info = info ? info : &own;
  return take_result(subscription, real_rcl_take_serialized_message()(subscription, message, info, allocation), info);
}

EXPORT int rcl_take_loaned_message(const void *subscription, void **message, struct message_info *info,
                                   void *allocation)
{
  struct message_info own = {0};
  end_input();
  info = info ? info : &own;
  int result = real_rcl_take_loaned_message()(subscription, message, info, allocation);
  result = take_result(subscription, result, info);
  if (result == TAKE_FAILED && *message) {
    real_rcl_return_loaned_message_from_subscription()(subscription, *message);
    *message = NULL;
  }
  return result;
}
