/* Meets a fault, says what it means, takes the cause away, clears it and goes on.
 *
 *     fault_and_recover "tmcl+serial:///dev/ttyUSB0:9600#1"
 *
 * On a simulated drive it lets the supply sag; on a real one it reports what happens by itself. */
#include "check.h"

int main(int argc, char **argv)
{
    pp_error error = { .size = sizeof error };
    pp_axis *axis;
    pp_link *link = open_first(argc > 1 ? argv[1] : "sim:tmcl?time=virtual", &axis);
    double fault, velocity;
    pp_status status;

    check(pp_axis_arm(axis), axis, link);
    check(pp_axis_enable(axis), axis, link);
    check(pp_axis_velocity_text(axis, "300 rpm", PP_NTS), axis, link);
    pp_link_sleep(link, 0.5);
    puts("turning");

    pp_simulation_act(link, 0, "supply=8", PP_NTS);
    pp_link_sleep(link, 0.5);
    check(pp_axis_read(axis, PP_SIGNAL_FAULT, &fault), axis, link);
    printf("fault code %g\n", fault);
    status = pp_axis_enable(axis);
    if (status == PP_DRIVE_FAULT) {
        pp_axis_error(axis, &error);
        puts(error.message);
        printf("what to do: %s\n", error.hint);
    } else {
        check(status, axis, link);
        puts("no fault");
    }

    pp_simulation_act(link, 0, "supply=24", PP_NTS); /* the cause goes first */
    pp_link_sleep(link, 0.5);
    check(pp_axis_clear(axis), axis, link);
    check(pp_axis_enable(axis), axis, link);
    check(pp_axis_velocity_text(axis, "300 rpm", PP_NTS), axis, link);
    pp_link_sleep(link, 0.5);
    check(pp_axis_read(axis, PP_SIGNAL_VELOCITY, &velocity), axis, link);
    printf("turning again at %.1f rad/s\n", velocity);
    check(pp_axis_release(axis), axis, link);
    close_both(link, axis);
    return 0;
}
