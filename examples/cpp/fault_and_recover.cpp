// Meets a fault, says what it means, takes the cause away, clears it and goes on.
//
//     fault_and_recover "tmcl+serial:///dev/ttyUSB0:9600#1"
//
// On a simulated drive it lets the supply sag; on a real one it reports what happens by itself.
#include <polepair.hpp>

#include <cstdio>
#include <iostream>

int main(int argc, char **argv)
try {
    polepair::Link link(argc > 1 ? argv[1] : "sim:tmcl?time=virtual");
    polepair::Axis axis = link.axis_at(0);
    bool simulated = axis.info().is_simulated;

    polepair::Armed armed(axis);
    axis.velocity("300 rpm");
    link.sleep(0.5);
    std::puts("turning");

    if (simulated)
        link.act(0, "supply=8");
    link.sleep(0.5);
    std::printf("fault code %g\n", axis.read(PP_SIGNAL_FAULT));
    try {
        axis.enable();
        std::puts("no fault");
    } catch (const polepair::Error &error) {
        if (error.status() != PP_DRIVE_FAULT)
            throw;
        std::printf("%s\nwhat to do: %s\n", error.what(), error.hint());
    }

    if (simulated)
        link.act(0, "supply=24"); // the cause goes first
    link.sleep(0.5);
    axis.clear();
    axis.enable();
    axis.velocity("300 rpm");
    link.sleep(0.5);
    std::printf("turning again at %.1f rad/s\n", axis.read(PP_SIGNAL_VELOCITY));
    armed.release();
} catch (const polepair::Error &error) {
    std::cerr << error.code() << ": " << error.what() << "\n  try: " << error.hint() << '\n';
    return 1;
}
