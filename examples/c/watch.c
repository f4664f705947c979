/* Shows position, speed and current of every axis on a link, without moving any.
 *
 *     watch "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10
 *
 * The second word is how many readings are shown (5). */
#include "check.h"

int main(int argc, char **argv)
{
    const char *url = argc > 1 ? argv[1] : "sim:tmcl:1,3?time=virtual";
    static const struct { pp_signal signal; const char *name; } wanted[] = {
        { PP_SIGNAL_POSITION, "position" },
        { PP_SIGNAL_VELOCITY, "velocity" },
        { PP_SIGNAL_CURRENT, "current" },
    };
    int readings = argc > 2 ? atoi(argv[2]) : 5, row, has;
    pp_error error = { .size = sizeof error };
    size_t count, at, n, i;
    pp_link *link;

    if (pp_link_open(url, PP_NTS, &link) != PP_OK) {
        pp_link_error(link, &error);
        fail(&error, link);
    }
    pp_link_axis_count(link, &count);
    for (at = 0; at < count; at++) {
        pp_axis_info info = { .size = sizeof info };
        pp_signal signals[3];
        const char *names[3];
        double values[3], time;
        pp_trace *trace;
        pp_axis *axis;

        pp_link_axis_at(link, at, &axis);
        pp_axis_get_info(axis, &info);
        printf("%s (%s)\n", info.label, info.title);
        /* Only what this drive can tell. */
        for (n = i = 0; i < 3; i++) {
            if (pp_axis_has_signal(axis, wanted[i].signal, &has) == PP_OK && has) {
                signals[n] = wanted[i].signal;
                names[n++] = wanted[i].name;
            }
        }
        check(pp_axis_trace(axis, signals, n, 0.1, &trace), axis, link);
        for (row = 0; row < readings; row++) {
            if (pp_trace_read(trace, 10.0, &time, values) != PP_OK) {
                pp_trace_error(trace, &error);
                fail(&error, link);
            }
            for (i = 0; i < n; i++)
                printf("  %s %.4f", names[i], values[i]);
            putchar('\n');
        }
        pp_trace_close(trace);
        pp_axis_close(axis);
    }
    pp_link_close(link, NULL);
    return 0;
}
