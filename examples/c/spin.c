/* Turns a motor for a while. It is stopped and switched off when the link is closed.
 *
 *     spin "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm" 3 */
#include "check.h"

int main(int argc, char **argv)
{
    const char *url = argc > 1 ? argv[1] : "sim:tmcl?time=virtual";
    const char *speed = argc > 2 ? argv[2] : "60 rpm";
    double seconds = argc > 3 ? atof(argv[3]) : 2.0, velocity;
    pp_axis_info info = { .size = sizeof info };
    pp_axis *axis;
    pp_link *link = open_first(url, &axis);
    int i;

    pp_axis_get_info(axis, &info);
    printf("%s: %s\n", info.title, info.caution);

    check(pp_axis_arm(axis), axis, link);
    check(pp_axis_enable(axis), axis, link); /* enabled where it stands */
    check(pp_axis_velocity_text(axis, speed, PP_NTS), axis, link);
    for (i = 0; i < 4; i++) {
        pp_link_sleep(link, seconds / 4);
        check(pp_axis_read(axis, PP_SIGNAL_VELOCITY, &velocity), axis, link);
        printf("%.1f rpm\n", velocity * 60 / 6.283185307179586);
    }
    check(pp_axis_release(axis), axis, link); /* stopped, switched off, disarmed */
    close_both(link, axis);
    return 0;
}
