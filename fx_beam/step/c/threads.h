/* Threads that take the parts of a task in turns. Which thread takes a part changes no number: no part reads or writes what
   another one writes. */

#pragma once

#include <pthread.h>
#include <signal.h>
#include <unistd.h>
#include "vectors.h"

/* Does a part of a task, in a thread with this number. */
typedef void Task(const void *task, int part, int thread);

/* The threads of a process, of which a fork has none; the process in which a caller has them; the task of this round, which is
   `open` as long as its parts are taken, and how many of the other threads are `working` at it. */
static struct {
  pthread_mutex_t lock; pthread_cond_t begun, ended; pid_t process, taken; int threads;
  Task *run; const void *task; int parts, next, wanted, round, open, working;
} pool;

/* So many looks at what another thread changes, some 20 us, before a thread sleeps. */
enum { LOOKS = 1000 };

#if defined __x86_64__
#define PAUSE() __builtin_ia32_pause()
#else
#define PAUSE() __asm__ volatile("" ::: "memory")
#endif
#define LOOK_WHILE(condition) for (int k = 0; k < LOOKS && (condition); ++k) PAUSE()
#define NOW(number) __atomic_load_n(&(number), __ATOMIC_RELAXED)

static void take_parts(int thread) {
  for (int k; (k = __atomic_fetch_add(&pool.next, 1, __ATOMIC_RELAXED)) < pool.parts;) pool.run(pool.task, k, thread);
}

static void *work_in_rounds(void *number) {
  int thread = (int)(intptr_t)number;
  pthread_mutex_lock(&pool.lock);
  for (int last = 0;;) {
    pthread_mutex_unlock(&pool.lock);
    LOOK_WHILE(NOW(pool.round) == last);
    pthread_mutex_lock(&pool.lock);
    while (pool.round == last) pthread_cond_wait(&pool.begun, &pool.lock);
    last = pool.round;
    if (!pool.open || thread >= pool.wanted) continue;
    ++pool.working;
    pthread_mutex_unlock(&pool.lock);
    take_parts(thread);
    pthread_mutex_lock(&pool.lock);
    if (!--pool.working) pthread_cond_signal(&pool.ended);
  }
  return 0;
}

/* Starts the threads that are missing, with all signals blocked: these are for the thread of Python. */
static void start_threads(int threads) {
  sigset_t all, before;
  if (pool.process != getpid()) {
    pool.process = getpid(), pool.threads = 1, pool.round = pool.open = pool.working = 0;
    pthread_mutex_init(&pool.lock, 0), pthread_cond_init(&pool.begun, 0), pthread_cond_init(&pool.ended, 0);
  }
  if (pool.threads >= threads) return;
  sigfillset(&all), pthread_sigmask(SIG_SETMASK, &all, &before);
  for (pthread_t made; pool.threads < threads; ++pool.threads) {
    if (pthread_create(&made, 0, work_in_rounds, (void *)(intptr_t)pool.threads)) break;
    pthread_detach(made);
  }
  pthread_sigmask(SIG_SETMASK, &before, 0);
}

/* Does all parts of a task, on so many threads, or on the caller's alone if another caller has the others. */
static void share(int threads, int parts, Task *run, const void *task) {
  pid_t process = threads > 1 && parts > 1 ? getpid() : 0, taken = NOW(pool.taken);
  int ours = process && taken != process; /* a fork may find what its parent had taken */
  if (!ours || !__atomic_compare_exchange_n(&pool.taken, &taken, process, 0, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED)) {
    for (int k = 0; k < parts; ++k) run(task, k, 0);
    return;
  }
  start_threads(threads);
  pthread_mutex_lock(&pool.lock);
  pool.run = run, pool.task = task, pool.parts = parts, pool.next = 0, pool.wanted = threads, pool.open = 1, ++pool.round;
  pthread_cond_broadcast(&pool.begun);
  pthread_mutex_unlock(&pool.lock);
  take_parts(0);
  LOOK_WHILE(NOW(pool.working));
  pthread_mutex_lock(&pool.lock);
  for (pool.open = 0; pool.working;) pthread_cond_wait(&pool.ended, &pool.lock);
  pthread_mutex_unlock(&pool.lock);
  __atomic_store_n(&pool.taken, 0, __ATOMIC_RELEASE);
}
