/* Runs a program, and sends it a signal of the console as the system does: by a thread in the program that calls
 * CtrlRoutine of kernelbase.dll.
 *
 *     console.exe ctrl-c|ctrl-break|close|logoff COMMAND LINE
 *
 * The signal is sent after a line of input. Prints the exit code of the program and how long it took to end. */
#include <windows.h>
#include <stdio.h>
#include <string.h>

int main(int argc, char **argv)
{
    static const struct { const char *name; DWORD event; } events[] = {
        { "ctrl-c", CTRL_C_EVENT }, { "ctrl-break", CTRL_BREAK_EVENT },
        { "close", CTRL_CLOSE_EVENT }, { "logoff", CTRL_LOGOFF_EVENT },
    };
    STARTUPINFOA start = { .cb = sizeof start };
    PROCESS_INFORMATION child;
    LPTHREAD_START_ROUTINE routine;
    char line[16];
    DWORD code, began, n;

    for (n = 0; argc == 3 && n < 4 && strcmp(argv[1], events[n].name); n++)
        ;
    if (argc != 3 || n == 4)
        return 2;
    routine = (LPTHREAD_START_ROUTINE)(void *)GetProcAddress(GetModuleHandleA("kernelbase.dll"), "CtrlRoutine");
    if (!routine || !CreateProcessA(NULL, argv[2], NULL, NULL, TRUE, 0, NULL, NULL, &start, &child)) {
        printf("cannot start it: %lu\n", GetLastError());
        return 3;
    }
    if (!fgets(line, sizeof line, stdin))
        return 2;
    began = GetTickCount();
    if (!CreateRemoteThread(child.hProcess, NULL, 0, routine, (LPVOID)(ULONG_PTR)events[n].event, 0, NULL))
        printf("cannot signal it: %lu\n", GetLastError());
    if (WaitForSingleObject(child.hProcess, 20000)) {
        printf("it still runs\n");
        TerminateProcess(child.hProcess, 99);
        return 3;
    }
    GetExitCodeProcess(child.hProcess, &code);
    printf("ended with %ld after %lu ms\n", (long)code, (unsigned long)(GetTickCount() - began));
    return 0;
}
