/// TL_FAST, in front of a function's definition: the control loop or the onset detector reaches it. A port whose code
/// memory is slow names a section that is not (TL_FAST_SECTION, such as ".time_critical.tautline"); elsewhere it means
/// nothing. Each function gets a section of its own, so that the linker leaves out what nobody calls.
///
/// TL_FAST_LOCKED: what the task runs with the control step kept out, from the lock to its end. It stays a function, so
/// that no caller in slow memory takes it in.
#ifndef TAUTLINE_TL_FAST_H
#define TAUTLINE_TL_FAST_H

#ifdef TL_FAST_SECTION
#define TL_FAST_TEXT_(line)    #line
#define TL_FAST_SECTION_(line) TL_FAST_SECTION "." TL_FAST_TEXT_(line)
#define TL_FAST                __attribute__((section(TL_FAST_SECTION_(__LINE__))))
#else
#define TL_FAST
#endif
#define TL_FAST_LOCKED __attribute__((noinline)) TL_FAST

#endif
