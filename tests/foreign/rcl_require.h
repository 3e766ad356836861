/* Ends the program where a call of rcl has failed. */
#include <rcl/error_handling.h>
#include <rcl/rcl.h>
#include <stdio.h>
#include <stdlib.h>

static void require(rcl_ret_t result, const char *what)
{
  if (result == RCL_RET_OK)
    return;
  fprintf(stderr, "%s: %s\n", what, rcl_get_error_string().str);
  exit(1);
}
