/* Ends a program with the error of a handle, after the link has stopped what is armed. */
#ifndef CHECK_H
#define CHECK_H

#include <polepair.h>
#include <stdio.h>
#include <stdlib.h>

static inline void fail(const pp_error *error, pp_link *link)
{
    fprintf(stderr, "%s: %s\n", error->code, error->message);
    if (error->hint[0])
        fprintf(stderr, "  try: %s\n", error->hint);
    if (error->may_turn)
        fprintf(stderr, "  the motor may still turn: cut its supply\n");
    pp_link_close(link, NULL);
    exit(1);
}

/* For calls on an axis. */
static inline void check(pp_status status, const pp_axis *axis, pp_link *link)
{
    pp_error error = { .size = sizeof error };

    if (status == PP_OK)
        return;
    pp_axis_error(axis, &error);
    fail(&error, link);
}

/* Opens a link and its first axis. */
static inline pp_link *open_first(const char *url, pp_axis **axis)
{
    pp_error error = { .size = sizeof error };
    pp_link *link;

    if (pp_link_open(url, PP_NTS, &link) != PP_OK || pp_link_axis_at(link, 0, axis) != PP_OK) {
        pp_link_error(link, &error);
        fail(&error, link);
    }
    return link;
}

/* Closes both; the link stops and disables the axis if it is still armed. */
static inline void close_both(pp_link *link, pp_axis *axis)
{
    pp_error error = { .size = sizeof error };

    pp_axis_close(axis);
    if (pp_link_close(link, &error) != PP_OK)
        fail(&error, NULL);
}

#endif
