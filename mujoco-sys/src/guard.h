// The guard around MuJoCo calls that may raise a fatal error: where to go back to, and where the message goes.
#ifndef SUPPLE_MUJOCO_GUARD_H
#define SUPPLE_MUJOCO_GUARD_H

#include <setjmp.h>
#include <stddef.h>

extern _Thread_local jmp_buf* supple_catch_point;
extern _Thread_local char* supple_error_text;

// Runs `call` and returns 0 from the function around it, or 1 if an error was raised; its message is then in `error`.
#define GUARDED(call)              \
  do {                             \
    jmp_buf here;                  \
    supple_catch_point = &here;    \
    supple_error_text = error;     \
    error[0] = '\0';               \
    if (setjmp(here)) {            \
      supple_catch_point = NULL;   \
      return 1;                    \
    }                              \
    call;                          \
    supple_catch_point = NULL;     \
    return 0;                      \
  } while (0)

// Raises an error of our own within GUARDED; never returns.
_Noreturn void supple_fail(const char* message);

#endif
