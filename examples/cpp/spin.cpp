// Turns a motor for a while. It is stopped and switched off however this ends.
//
//     spin "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm" 3
#include <polepair.hpp>

#include <cstdio>
#include <iostream>

int main(int argc, char **argv)
try {
    const char *speed = argc > 2 ? argv[2] : "60 rpm";
    double seconds = argc > 3 ? std::stod(argv[3]) : 2.0;
    polepair::Link link(argc > 1 ? argv[1] : "sim:tmcl?time=virtual");
    polepair::Axis axis = link.axis_at(0);
    pp_axis_info info = axis.info();
    std::printf("%s: %s\n", info.title, info.caution);

    polepair::Armed armed(axis); // enabled where it stands
    axis.velocity(speed);
    for (int i = 0; i < 4; i++) {
        link.sleep(seconds / 4);
        std::printf("%.1f rpm\n", axis.read(PP_SIGNAL_VELOCITY) * 60 / 6.283185307179586);
    }
    armed.release(); // stopped, switched off, disarmed; its destructor does the same
} catch (const polepair::Error &error) {
    std::cerr << error.code() << ": " << error.what() << "\n  try: " << error.hint() << '\n';
    return 1;
}
