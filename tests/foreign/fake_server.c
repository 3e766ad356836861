/* A server: `fake_server SERVICE`. It does what each line of its input says, and then writes a line: `take` takes a request,
 * `plain` by the function that does not say when it was received, `answer N` answers the one of that number (from 1),
 * `wait MS` waits for requests for so long, as an executor does, of which none comes, and `events` has a callback called for
 * each instead. `fake_server SERVICE REQUESTS`: takes and answers so many, and writes how much processor time one takes (ns);
 * with a further argument, by the other function that takes.
 * With HUMBLE, the type of the service is as there.
 * It uses a copy of what rcl has initialized, as rclcpp does with the servers of a lifecycle node. */
#define _GNU_SOURCE
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

struct request_id {
  uint8_t client[16];
  int64_t number;
};

struct request_info {
  int64_t sent, received;
  struct request_id id;
};

struct wait_set {
  const void **subscriptions;
  size_t subscription_count;
  const void **guards;
  size_t guard_count;
  const void **timers;
  size_t timer_count;
  const void **clients;
  size_t client_count;
  const void **services;
  size_t service_count;
  const void **events;
  size_t event_count;
  void *impl;
};

const void *rosidl_typesupport_c__get_service_type_support_handle__fakes__srv__Fake(void);
int rcl_service_init(void *, const void *, const void *, const char *, const void *);
int rcl_take_request(const void *, struct request_id *, void *);
int rcl_take_request_with_info(const void *, struct request_info *, void *);
int rcl_send_response(const void *, struct request_id *, void *);
int rcl_service_set_on_new_request_callback(const void *, void (*)(const void *, size_t), const void *);
int rcl_wait(struct wait_set *, int64_t);

static void come(const void *context, size_t number)
{
  (void)context, (void)number;
}

static void wait_for_requests(const void *service, long milliseconds)
{
  const void *services[] = {service};
  struct wait_set set = {.services = services, .service_count = 1, .impl = &set};
  rcl_wait(&set, milliseconds * 1000000);
}

int main(int count, char **arguments)
{
#ifdef HUMBLE
  const void *type = rosidl_typesupport_c__get_service_type_support_handle__fakes__srv__Fake();
#else
  static const void *const type[5] = {"of a test", NULL, NULL, "request", "response"};
#endif
  static const uint64_t options[16];
  const char *made, *service;
  uint64_t request[16] = {0}, response[16] = {0};
  struct request_info info = {0};
  rcl_service_init(&made, NULL, type, arguments[1], options);
  service = made;
  if (count > 2) {
    long long requests = atoll(arguments[2]);
    struct timespec begun, used;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &begun);
    for (long long number = 0; number < requests; number++) {
      if (count > 3)
        rcl_take_request(&service, &info.id, request);
      else
        rcl_take_request_with_info(&service, &info, request);
      rcl_send_response(&service, &info.id, response);
    }
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
    double seconds = (double)(used.tv_sec - begun.tv_sec) + (double)(used.tv_nsec - begun.tv_nsec) / 1e9;
    printf("%.1f\n", seconds * 1e9 / (double)requests);
    return 0;
  }
  puts("ready");
  fflush(stdout);
  for (char line[64]; fgets(line, sizeof line, stdin);) {
    long number = strchr(line, ' ') ? atol(strchr(line, ' ') + 1) : 0;
    if (strncmp(line, "take", 4) == 0)
      rcl_take_request_with_info(&service, &info, request);
    else if (strncmp(line, "plain", 5) == 0)
      rcl_take_request(&service, &info.id, request);
    else if (strncmp(line, "answer", 6) == 0) {
      info.id.number = number;
      rcl_send_response(&service, &info.id, response);
    } else if (strncmp(line, "wait", 4) == 0)
      wait_for_requests(&service, number);
    else
      rcl_service_set_on_new_request_callback(&service, come, NULL);
    puts("done");
    fflush(stdout);
  }
  return 0;
}
