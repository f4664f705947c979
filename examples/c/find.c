/* Finds the drives on a link, by reads only.
 *
 *     find tmcl+serial:///dev/ttyUSB0:9600 32
 *
 * The second word is the highest address that is tried (8). */
#include "check.h"

int main(int argc, char **argv)
{
    const char *url = argc > 1 ? argv[1] : "sim:tmcl:1,3?time=virtual";
    uint32_t last = argc > 2 ? (uint32_t)atoi(argv[2]) : 8;
    pp_error error = { .size = sizeof error };
    size_t count, i;
    pp_scan *scan;

    if (pp_scan_open(url, PP_NTS, 1, last, &scan) != PP_OK) {
        pp_scan_error(scan, &error);
        pp_scan_close(scan);
        fail(&error, NULL);
    }
    pp_scan_count(scan, &count);
    for (i = 0; i < count; i++) {
        pp_found found = { .size = sizeof found };

        pp_scan_at(scan, i, &found);
        printf("%u: %s, %s\n", (unsigned)found.number, found.title, found.identity);
        if (found.clash[0])
            printf("   %s\n", found.clash);
    }
    if (count == 0)
        puts("nobody answered");
    pp_scan_close(scan);
    return 0;
}
