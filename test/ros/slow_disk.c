/* SPDX-License-Identifier: Apache-2.0
 * Preloaded into a process: every write to an MCAP file takes as long as a busy disk. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

ssize_t write(int file, const void *data, size_t size)
{
    static ssize_t (*plain)(int, const void *, size_t);
    char link[32], path[4096];
    if (!plain)
        plain = (ssize_t (*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path);
    if (length > 5 && !memcmp(path + length - 5, ".mcap", 5))
        usleep(atoi(getenv("DISK_MICROSECONDS")));
    return plain(file, data, size);
}
