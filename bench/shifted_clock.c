/* Copyright 2026 the allan_ros authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Moves the wall clock of one process while it runs: preload it, and write an int64 of seconds into
 * the file that SHIFTED_CLOCK names. Waits until a wall-clock time end as they
 * would without the shift; other clocks are not changed. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

/* A time before 2001 belongs to a steady clock, which starts at boot, not to the wall clock. */
#define WALL_S 1000000000

static const volatile int64_t none = 0;
static const volatile int64_t *shift_s = &none;

__attribute__((constructor)) static void map_shift(void)
{
    const char *path = getenv("SHIFTED_CLOCK");
    int file = path ? open(path, O_RDONLY) : -1;
    if (file < 0)
        return;
    void *mapped = mmap(NULL, sizeof(*shift_s), PROT_READ, MAP_SHARED, file, 0);
    if (mapped != MAP_FAILED)
        shift_s = mapped;
    close(file);
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int failed = syscall(SYS_clock_gettime, clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += *shift_s;
    return failed;
}

int gettimeofday(struct timeval *now, void *zone)
{
    struct timespec precise;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now)
{
    struct timespec precise;
    clock_gettime(CLOCK_REALTIME, &precise);
    if (now)
        *now = precise.tv_sec;
    return precise.tv_sec;
}

static const struct timespec *kernel_time(const struct timespec *until, struct timespec *moved)
{
    if (!until || until->tv_sec < WALL_S)
        return until;
    *moved = *until;
    moved->tv_sec -= *shift_s;
    return moved;
}

int pthread_cond_timedwait(pthread_cond_t *cond, pthread_mutex_t *mutex, const struct timespec *until)
{
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    struct timespec moved;
    if (!real) /* the version with the condition variables of today */
        real = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    return real(cond, mutex, kernel_time(until, &moved));
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *until)
{
    static int (*real)(pthread_mutex_t *, const struct timespec *);
    struct timespec moved;
    if (!real)
        real = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    return real(mutex, kernel_time(until, &moved));
}

int sem_timedwait(sem_t *semaphore, const struct timespec *until)
{
    static int (*real)(sem_t *, const struct timespec *);
    struct timespec moved;
    if (!real)
        real = dlsym(RTLD_NEXT, "sem_timedwait");
    return real(semaphore, kernel_time(until, &moved));
}
