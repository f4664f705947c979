/* Reads and writes parameters by name, with units.
 *
 *     parameters "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"
 *
 * It writes back the value that it read: a drive keeps the settings it had. */
#include "check.h"
#include <inttypes.h>
#include <string.h>

int main(int argc, char **argv)
{
    const char *name = argc > 2 ? argv[2] : "max current";
    pp_parameter parameter = { .size = sizeof parameter };
    pp_axis_info info = { .size = sizeof info };
    pp_error error = { .size = sizeof error };
    pp_axis *axis;
    pp_link *link = open_first(argc > 1 ? argv[1] : "sim:tmcl?time=virtual", &axis);
    char text[256];
    double before;
    int64_t raw;
    size_t i;

    pp_axis_get_info(axis, &info);
    printf("%s is a %s\n", info.label, info.title);

    check(pp_axis_get_text(axis, name, PP_NTS, text, sizeof text, NULL), axis, link);
    check(pp_axis_get_raw(axis, name, PP_NTS, &raw), axis, link);
    printf("%s = %s (on the wire %" PRId64 ")\n", name, text, raw);
    for (i = 0; pp_axis_parameter_at(axis, i, &parameter) == PP_OK; i++)
        if (strcmp(parameter.name, name) == 0)
            break;
    printf("%s In the manual: %s\n", parameter.about, parameter.symbol);

    /* In the parameter's own unit; text may carry another one: pp_axis_set_text(…, "1200 mA", …). */
    check(pp_axis_get(axis, name, PP_NTS, &before), axis, link);
    check(pp_axis_set(axis, name, PP_NTS, before), axis, link);

    /* Outside the limits nothing is sent. */
    if (pp_axis_set_raw(axis, name, PP_NTS, parameter.raw_max + 1, 0) == PP_OK) {
        puts("the limit is not where the profile says");
    } else {
        pp_axis_error(axis, &error);
        if (error.executed != 0)
            fail(&error, link);
        printf("%s: %s\n", error.code, error.message);
    }
    close_both(link, axis);
    return 0;
}
