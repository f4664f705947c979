/* Runs a program, and sends it a signal of the console as the system does: by a thread in the program that calls
 * CtrlRoutine of kernelbase.dll.
 *
 *     console.exe ctrl-c|ctrl-break|close|logoff COMMAND LINE
 *
 * The signal is sent after a line of input. Prints the exit code of the program and how long it took to end.
 *
 * Wine makes a thread in another process by asking one of that process' threads to do it, and waits for that without
 * limit; this program has been seen to print nothing for two minutes, with no other wait that is as long. The call is
 * therefore left to a thread of its own, which is given up after a while, and is made anew. */
#include <windows.h>
#include <stdio.h>
#include <string.h>

enum { ATTEMPTS = 4, ATTEMPT_MS = 10000, END_MS = 20000 };

static PROCESS_INFORMATION child;
static LPTHREAD_START_ROUTINE routine;

static DWORD WINAPI signal_child(LPVOID event)
{
    return CreateRemoteThread(child.hProcess, NULL, 0, routine, event, 0, NULL) ? 0 : GetLastError();
}

/* Returns 0 once the program has the signal, else an error of the system. */
static DWORD send_signal(DWORD event)
{
    DWORD code = WAIT_TIMEOUT;

    for (int attempt = 0; attempt < ATTEMPTS; attempt++) {
        HANDLE sender = CreateThread(NULL, 0, signal_child, (LPVOID)(ULONG_PTR)event, 0, NULL);
        if (!sender)
            return GetLastError();
        if (WaitForSingleObject(sender, ATTEMPT_MS) == WAIT_OBJECT_0) {
            GetExitCodeThread(sender, &code);
            CloseHandle(sender);
            return code;
        }
        printf("no thread takes the signal, attempt %d\n", attempt + 1);
    }
    return code;
}

int main(int argc, char **argv)
{
    static const struct { const char *name; DWORD event; } events[] = {
        { "ctrl-c", CTRL_C_EVENT }, { "ctrl-break", CTRL_BREAK_EVENT },
        { "close", CTRL_CLOSE_EVENT }, { "logoff", CTRL_LOGOFF_EVENT },
    };
    STARTUPINFOA start = { .cb = sizeof start };
    char line[16];
    DWORD code, began, n;

    setvbuf(stdout, NULL, _IONBF, 0);
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
    code = send_signal(events[n].event);
    if (code)
        printf("cannot signal it: %lu\n", code);
    if (WaitForSingleObject(child.hProcess, END_MS)) {
        printf("it still runs\n");
        TerminateProcess(child.hProcess, 99);
        return 3;
    }
    GetExitCodeProcess(child.hProcess, &code);
    printf("ended with %ld after %lu ms\n", (long)code, (unsigned long)(GetTickCount() - began));
    return 0;
}
