/* Finds the reference position, then moves there and back.
 *
 *     move_and_home modbus-rtu+serial:///dev/ttyUSB0:115200#1
 *
 * A drive that cannot home says so, and is moved from where it stands. */
#include "check.h"

#define AT_MOST 60.0

int main(int argc, char **argv)
{
    const char *targets[] = { "90 deg", "0 deg" };
    pp_error error = { .size = sizeof error };
    pp_request *homing;
    pp_axis *axis;
    pp_link *link = open_first(argc > 1 ? argv[1] : "sim:tmcl?time=virtual", &axis);
    double position;
    pp_status status;
    int i;

    /* A switch at half a turn, as a mechanic would fit one. A real link is no simulation. */
    pp_simulation_act(link, 0, "home=0.5turn", PP_NTS);

    check(pp_axis_arm(axis), axis, link);
    check(pp_axis_enable(axis), axis, link);
    status = pp_axis_begin(axis, PP_HOME, 0, NULL, &homing);
    if (status == PP_OK) {
        status = pp_request_wait(homing, AT_MOST);
        if (status == PP_OK) {
            puts("home found");
        } else if (status == PP_PENDING) {
            puts("no home in time");
        } else {
            pp_request_error(homing, &error);
            fail(&error, link);
        }
        pp_request_close(homing);
    } else {
        pp_axis_error(axis, &error);
        puts(error.message);
    }

    for (i = 0; i < 2; i++) {
        check(pp_axis_move_to_text(axis, targets[i], PP_NTS), axis, link);
        check(pp_axis_wait(axis, AT_MOST), axis, link);
        check(pp_axis_read(axis, PP_SIGNAL_POSITION, &position), axis, link);
        printf("at %s: %.4f rad\n", targets[i], position);
    }
    check(pp_axis_move_by_text(axis, "-45 deg", PP_NTS), axis, link); /* never sent twice */
    check(pp_axis_wait(axis, AT_MOST), axis, link);
    check(pp_axis_read(axis, PP_SIGNAL_POSITION, &position), axis, link);
    printf("45 degrees back: %.4f rad\n", position);
    check(pp_axis_release(axis), axis, link);
    close_both(link, axis);
    return 0;
}
