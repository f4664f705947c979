// Finds the reference position, then moves there and back:
// move_and_home modbus-rtu+serial:///dev/ttyUSB0:115200#1
using System;
using System.Globalization;
using Polepair;

static class MoveAndHome
{
    const double AtMost = 60.0;

    static int Main(string[] words)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        using (var link = new Link(words.Length > 0 ? words[0] : "sim:tmcl?time=virtual"))
        using (Axis axis = link.AxisAt(0))
        {
            if (axis.IsSimulated)
                link.Act(0, "home=0.5turn"); // a switch, as a mechanic would fit one
            using (axis.Armed())
            {
                try
                {
                    using (Request homing = axis.Begin(Verb.Home))
                        Console.WriteLine(homing.Wait(AtMost) ? "home found" : "no home in time");
                }
                catch (PolepairException error) when (error.Status == Status.Usage)
                {
                    Console.WriteLine(error.Message); // a drive that cannot home is moved from where it stands
                }
                foreach (string target in new[] { "90 deg", "0 deg" })
                {
                    axis.MoveTo(target);
                    axis.Wait(AtMost);
                    Console.WriteLine($"at {target}: {axis.Read(Signal.Position):F4} rad");
                }
                axis.MoveBy("-45 deg"); // never sent twice
                axis.Wait(AtMost);
                Console.WriteLine($"45 degrees back: {axis.Read(Signal.Position):F4} rad");
            }
        }
        return 0;
    }
}
