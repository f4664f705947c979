// Meets a fault, says what it means, takes the cause away, clears it and goes on:
// fault_and_recover "tmcl+serial:///dev/ttyUSB0:9600#1"
// On a simulated drive it lets the supply sag; on a real one it reports what happens by itself.
using System;
using System.Globalization;
using Polepair;

static class FaultAndRecover
{
    static int Main(string[] words)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        using (var link = new Link(words.Length > 0 ? words[0] : "sim:tmcl?time=virtual"))
        using (Axis axis = link.AxisAt(0))
        using (axis.Armed())
        {
            axis.Velocity("300 rpm");
            link.Sleep(0.5);
            Console.WriteLine("turning");

            if (axis.IsSimulated)
                link.Act(0, "supply=8");
            link.Sleep(0.5);
            Console.WriteLine($"fault code {axis.Read(Signal.Fault)}");
            try
            {
                axis.Enable();
                Console.WriteLine("no fault");
            }
            catch (PolepairException error) when (error.Status == Status.DriveFault)
            {
                Console.WriteLine($"{error.Message}\nwhat to do: {error.Hint}");
            }

            if (axis.IsSimulated)
                link.Act(0, "supply=24"); // the cause goes first
            link.Sleep(0.5);
            axis.Clear();
            axis.Enable();
            axis.Velocity("300 rpm");
            link.Sleep(0.5);
            Console.WriteLine($"turning again at {axis.Read(Signal.Velocity):F1} rad/s");
        }
        return 0;
    }
}
