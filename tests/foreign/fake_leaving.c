/* A node in a container: `fake_leaving NODE TOPIC SERVICE`. The node has that full name, a subscription of the topic, a server of
 * the service, and clients of it. For each line of its input it does what the line says, and writes the result of rcl:
 * `take` takes a message, `request` a request, `response` and `info` a response, by one function and the other, and `timer`
 * calls a timer that it has made in a callback; `due` is how often that has been due, `calls` how often its callback was
 * called. `describe` makes its server of type descriptions. `over` ends the node, and not its servers, as rclpy does.
 * `begin` and `end` are what rclcpp says of a callback, `wait` waits, and `again` removes a client, and makes another one, many
 * times. */
#define _GNU_SOURCE
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct allocator {
  void *functions[5];
};

int rcl_node_init(void *, const char *, const char *, void *, const void *);
int rcl_subscription_init(void *, const void *, const void *, const char *, const void *);
int rcl_service_init(void *, const void *, const void *, const char *, const void *);
int rcl_node_type_description_service_init(void *, const void *);
int rcl_client_init(void *, const void *, const void *, const char *, const void *);
int rcl_client_fini(void *, void *);
int rcl_take(const void *, void *, void *, void *);
int rcl_take_request(const void *, void *, void *);
int rcl_take_response(const void *, void *, void *);
int rcl_take_response_with_info(const void *, void *, void *);
int rcl_timer_init(int *, void *, void *, int64_t, void *, struct allocator);
int rcl_timer_call(void *);
int rcl_wait(void *, int64_t);
int rcl_node_fini(void *);
void ros_trace_callback_start(const void *, bool);
void ros_trace_callback_end(const void *);

static int calls;

static void on_timer(void *timer, int64_t since)
{
  (void)timer, (void)since;
  calls++;
}

/* Many clients come and go, as with nodes that are loaded and unloaded. */
static void make_again(void *client, void *node, const char *service)
{
  static void *others[2000];
  static const char type;
  for (int round = 0; round < 5; round++)
    for (int index = 0; index < 2000; index++) {
      rcl_client_init(&others[index], node, &type, service, NULL);
      rcl_client_fini(&others[index], node);
    }
  rcl_client_fini(client, node);
  rcl_client_init(client, node, &type, service, NULL);
}

int main(int count, char **arguments)
{
  (void)count;
  static const char message_type;
  static const void *const service_type[5] = {"of a test", NULL, NULL, "request", "response"};
  static const uint64_t options[16];
  void *node, *subscription, *server, *description, *client;
  uint64_t buffer[16] = {0}, info[16] = {0}, id[3] = {0};
  int timer;
  rcl_node_init(&node, arguments[1], "", NULL, NULL);
  rcl_subscription_init(&subscription, &node, &message_type, arguments[2], NULL);
  rcl_service_init(&server, &node, service_type, arguments[3], options);
  rcl_client_init(&client, &node, &message_type, arguments[3], NULL);
  rcl_take_response(&client, id, buffer);
  rcl_timer_init(&timer, NULL, NULL, 0, on_timer, (struct allocator){{NULL}});
  rcl_wait(NULL, 1);
  puts("ready");
  fflush(stdout);
  for (char line[64]; fgets(line, sizeof line, stdin);) {
    int result = 0;
    line[strcspn(line, "\n")] = 0;
    if (strcmp(line, "take") == 0)
      result = rcl_take(&subscription, buffer, NULL, NULL);
    else if (strcmp(line, "request") == 0)
      result = rcl_take_request(&server, id, buffer);
    else if (strcmp(line, "response") == 0)
      result = rcl_take_response(&client, id, buffer);
    else if (strcmp(line, "info") == 0)
      result = rcl_take_response_with_info(&client, info, buffer);
    else if (strcmp(line, "timer") == 0)
      result = rcl_timer_call(&timer);
    else if (strcmp(line, "due") == 0)
      result = timer;
    else if (strcmp(line, "calls") == 0)
      result = calls;
    else if (strcmp(line, "describe") == 0)
      result = rcl_node_type_description_service_init(&description, &node);
    else if (strcmp(line, "over") == 0)
      result = rcl_node_fini(&node);
    else if (strcmp(line, "begin") == 0)
      ros_trace_callback_start(&node, false);
    else if (strcmp(line, "end") == 0)
      ros_trace_callback_end(&node);
    else if (strcmp(line, "wait") == 0)
      result = rcl_wait(NULL, 1);
    else
      make_again(&client, &node, arguments[3]);
    printf("%d\n", result);
    fflush(stdout);
  }
  return 0;
}
