// Finds the reference position, then moves there and back.
//
//     move_and_home modbus-rtu+serial:///dev/ttyUSB0:115200#1
//
// A drive that cannot home says so, and is moved from where it stands.
#include <polepair.hpp>

#include <cstdio>
#include <iostream>

constexpr double AT_MOST = 60.0;

int main(int argc, char **argv)
try {
    polepair::Link link(argc > 1 ? argv[1] : "sim:tmcl?time=virtual");
    polepair::Axis axis = link.axis_at(0);
    if (axis.info().is_simulated)
        link.act(0, "home=0.5turn"); // at half a turn, as a mechanic would fit one

    polepair::Armed armed(axis);
    try {
        bool ended = axis.begin(PP_HOME).wait(AT_MOST);
        std::puts(ended ? "home found" : "no home in time");
    } catch (const polepair::Error &error) {
        if (error.status() != PP_USAGE)
            throw;
        std::puts(error.what());
    }

    for (const char *target : {"90 deg", "0 deg"}) {
        axis.move_to(target);
        axis.wait(AT_MOST);
        std::printf("at %s: %.4f rad\n", target, axis.read(PP_SIGNAL_POSITION));
    }
    axis.move_by("-45 deg"); // never sent twice
    axis.wait(AT_MOST);
    std::printf("45 degrees back: %.4f rad\n", axis.read(PP_SIGNAL_POSITION));
    armed.release();
} catch (const polepair::Error &error) {
    std::cerr << error.code() << ": " << error.what() << "\n  try: " << error.hint() << '\n';
    return 1;
}
