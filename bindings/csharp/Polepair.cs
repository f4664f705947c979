// libpolepair for C#: P/Invoke, with handles that dispose of themselves and errors as exceptions.
//
//     using var link = new Polepair.Link("sim:tmcl");
//     using var axis = link.Axis("1");
//     using (axis.Armed())                      // stopped, disabled and disarmed at the end
//     {
//         axis.Velocity("60 rpm");
//         link.Sleep(2.0);
//     }
//
// polepair.h documents the rules of each function. One file: add it to a project, beside the library.
using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;
using System.Text;

namespace Polepair
{
    /// <summary>What a call returns; the codes below 64 are the exit codes of the command line.</summary>
    public enum Status
    {
        Ok = 0, Negative = 1, Usage = 2, Adapter = 3, NoReply = 4, Corrupt = 5, Refused = 6, Partial = 7,
        DriveFault = 8, Unconfirmed = 9, Pending = 64, Nothing = 65, Buffer = 66, Forked = 67, Defect = 68, Interrupted = 130,
    }

    /// <summary>What a drive can be told to do.</summary>
    public enum Verb
    {
        Enable, Disable, Clear, Velocity, Torque, MoveTo, MoveBy, MoveOn, CurveTo, CurveBy, Home, Store,
    }

    /// <summary>A signal; values are SI.</summary>
    public enum Signal
    {
        Position, Velocity, Torque, Current, Voltage, Temperature, TargetPosition, TargetVelocity, Fault,
        Enabled, Moving, Reached, Mode, Time,
    }

    /// <summary>What a failed call throws.</summary>
    public sealed class PolepairException : Exception
    {
        internal PolepairException(Native.Error error) : base(Native.Text(error.Message))
        {
            Status = (Status)error.Status;
            Code = Native.Text(error.Code);
            Hint = Native.Text(error.Hint);
            Executed = error.Executed < 0 ? (bool?)null : error.Executed == 1;
            MayTurn = error.MayTurn != 0;
        }

        /// <summary>What the call returned.</summary>
        public Status Status { get; }
        /// <summary>Stable code: "E401".</summary>
        public string Code { get; }
        /// <summary>What to try. May be empty.</summary>
        public string Hint { get; }
        /// <summary>Whether the drive executed the request; null if that is unknown.</summary>
        public bool? Executed { get; }
        /// <summary>The motor may still turn, and only cutting its supply stops it.</summary>
        public bool MayTurn { get; }
    }

    internal static class Native
    {
        internal const string Library = "polepair";

        [StructLayout(LayoutKind.Sequential)]
        internal struct Error
        {
            public uint Size;
            public int Status, Executed, MayTurn;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 32)] public byte[] Code;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 1024)] public byte[] Message;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 512)] public byte[] Hint;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct AxisInfo
        {
            public uint Size, Number, Kind, IsSimulated;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 64)] public byte[] Name;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 64)] public byte[] Label;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 32)] public byte[] Protocol;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 64)] public byte[] Profile;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 128)] public byte[] Title;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 512)] public byte[] Caution;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 256)] public byte[] Watchdog;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct Parameter
        {
            public uint Size, Readable, Writable, Moves;
            public long RawMin, RawMax;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 128)] public byte[] Name;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 64)] public byte[] Symbol;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 32)] public byte[] Unit;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 16)] public byte[] Kind;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 32)] public byte[] Persistence;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 512)] public byte[] About;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct Found
        {
            public uint Size, Number;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 64)] public byte[] Profile;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 128)] public byte[] Title;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 256)] public byte[] Identity;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 256)] public byte[] Clash;
        }

        internal delegate int CopyError(IntPtr handle, ref Error error);
        internal delegate int CopyText(byte[] buffer, UIntPtr capacity, out UIntPtr needed);

        const CallingConvention C = CallingConvention.Cdecl;

        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_open(byte[] url, UIntPtr length, out IntPtr link);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_close(IntPtr link, ref Error error);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_error(IntPtr link, ref Error error);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_axis_count(IntPtr link, out UIntPtr count);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_axis_at(IntPtr link, UIntPtr index, out IntPtr axis);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_axis(IntPtr link, byte[] name, UIntPtr length, out IntPtr axis);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_stop_all(IntPtr link);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_link_sleep(IntPtr link, double seconds);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_simulation_act(IntPtr link, UIntPtr drive, byte[] act, UIntPtr length);
        [DllImport(Library, CallingConvention = C)] internal static extern void pp_axis_close(IntPtr axis);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_error(IntPtr axis, ref Error error);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_get_info(IntPtr axis, ref AxisInfo info);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_get(IntPtr axis, byte[] name, UIntPtr length, out double value);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_get_raw(IntPtr axis, byte[] name, UIntPtr length, out long value);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_get_text(IntPtr axis, byte[] name, UIntPtr length, byte[] buffer, UIntPtr capacity, out UIntPtr needed);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_set(IntPtr axis, byte[] name, UIntPtr length, double value);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_set_raw(IntPtr axis, byte[] name, UIntPtr length, long value, int store);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_set_text(IntPtr axis, byte[] name, UIntPtr length, byte[] value, UIntPtr valueLength, int store);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_send(IntPtr axis, byte[] text, UIntPtr length, out long value);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_parameter_count(IntPtr axis, out UIntPtr count);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_parameter_at(IntPtr axis, UIntPtr index, ref Parameter parameter);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_has_signal(IntPtr axis, Signal signal, out int has);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_read(IntPtr axis, Signal signal, out double value);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_trace(IntPtr axis, int[] signals, UIntPtr count, double period, out IntPtr trace);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_trace_read(IntPtr trace, double seconds, out double time, double[] row);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_trace_error(IntPtr trace, ref Error error);
        [DllImport(Library, CallingConvention = C)] internal static extern void pp_trace_close(IntPtr trace);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_arm(IntPtr axis);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_release(IntPtr axis);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_stop(IntPtr axis);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_wait(IntPtr axis, double seconds);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_run(IntPtr axis, Verb verb, double target, IntPtr limits);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_run_text(IntPtr axis, Verb verb, byte[] target, UIntPtr length, IntPtr limits);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_axis_begin(IntPtr axis, Verb verb, double target, IntPtr limits, out IntPtr request);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_request_wait(IntPtr request, double seconds);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_request_cancel(IntPtr request);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_request_error(IntPtr request, ref Error error);
        [DllImport(Library, CallingConvention = C)] internal static extern void pp_request_close(IntPtr request);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_scan_open(byte[] url, UIntPtr length, uint first, uint last, out IntPtr scan);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_scan_error(IntPtr scan, ref Error error);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_scan_count(IntPtr scan, out UIntPtr count);
        [DllImport(Library, CallingConvention = C)] internal static extern int pp_scan_at(IntPtr scan, UIntPtr index, ref Found found);
        [DllImport(Library, CallingConvention = C)] internal static extern void pp_scan_close(IntPtr scan);

        internal static Error NewError() => new Error { Size = (uint)Marshal.SizeOf(typeof(Error)) };

        internal static byte[] Bytes(string text) => Encoding.UTF8.GetBytes(text);

        internal static UIntPtr Length(byte[] bytes) => (UIntPtr)bytes.Length;

        internal static string Text(byte[] bytes)
        {
            int end = Array.IndexOf(bytes, (byte)0);
            return Encoding.UTF8.GetString(bytes, 0, end < 0 ? bytes.Length : end);
        }

        internal static void Check(int status, IntPtr handle, CopyError copy)
        {
            if (status == 0)
                return;
            Error error = NewError();
            if (copy(handle, ref error) != 0)
                throw new InvalidOperationException($"polepair: status {status}");
            throw new PolepairException(error);
        }
    }

    /// <summary>A drive that a scan has found.</summary>
    public sealed class FoundDrive
    {
        internal FoundDrive(Native.Found found)
        {
            Number = found.Number;
            Profile = Native.Text(found.Profile);
            Title = Native.Text(found.Title);
            Identity = Native.Text(found.Identity);
            Clash = Native.Text(found.Clash);
        }

        public uint Number { get; }
        public string Profile { get; }
        public string Title { get; }
        public string Identity { get; }
        /// <summary>Two drives share its address. May be empty.</summary>
        public string Clash { get; }
    }

    /// <summary>A parameter, without its value.</summary>
    public sealed class Parameter
    {
        internal Parameter(Native.Parameter its)
        {
            Name = Native.Text(its.Name);
            Symbol = Native.Text(its.Symbol);
            Unit = Native.Text(its.Unit);
            About = Native.Text(its.About);
            RawMin = its.RawMin;
            RawMax = its.RawMax;
            Readable = its.Readable != 0;
            Writable = its.Writable != 0;
            Moves = its.Moves != 0;
        }

        public string Name { get; }
        public string Symbol { get; }
        public string Unit { get; }
        public string About { get; }
        public long RawMin { get; }
        public long RawMax { get; }
        public bool Readable { get; }
        public bool Writable { get; }
        /// <summary>Writing it may move the motor.</summary>
        public bool Moves { get; }
    }

    /// <summary>A request that was begun. Disposing of it does not end it.</summary>
    public sealed class Request : IDisposable
    {
        IntPtr handle;

        internal Request(IntPtr handle) { this.handle = handle; }

        /// <summary>Waits at most so many seconds; false if it has not ended.</summary>
        public bool Wait(double seconds) => HasEnded(Native.pp_request_wait(handle, seconds));

        /// <summary>Stops the axis of a motion, or ends a read; false if it has not ended.</summary>
        public bool Cancel() => HasEnded(Native.pp_request_cancel(handle));

        bool HasEnded(int status)
        {
            if (status == (int)Status.Pending)
                return false;
            Native.Check(status, handle, Native.pp_request_error);
            return true;
        }

        public void Dispose()
        {
            Native.pp_request_close(handle);
            handle = IntPtr.Zero;
        }
    }

    /// <summary>Signals again and again.</summary>
    public sealed class Trace : IDisposable
    {
        IntPtr handle;
        readonly int columns;

        internal Trace(IntPtr handle, int columns) { this.handle = handle; this.columns = columns; }

        /// <summary>The next row, with its time; null if there is none within so many seconds.</summary>
        public double[] Read(double seconds, out double time)
        {
            var row = new double[columns];
            int status = Native.pp_trace_read(handle, seconds, out time, row);
            if (status == (int)Status.Nothing)
                return null;
            Native.Check(status, handle, Native.pp_trace_error);
            return row;
        }

        public void Dispose()
        {
            Native.pp_trace_close(handle);
            handle = IntPtr.Zero;
        }
    }

    /// <summary>One axis: a motor.</summary>
    public sealed class Axis : IDisposable
    {
        IntPtr handle;

        internal Axis(IntPtr handle)
        {
            this.handle = handle;
            var info = new Native.AxisInfo { Size = (uint)Marshal.SizeOf(typeof(Native.AxisInfo)) };
            Check(Native.pp_axis_get_info(handle, ref info));
            Number = info.Number;
            IsSimulated = info.IsSimulated != 0;
            Label = Native.Text(info.Label);
            Profile = Native.Text(info.Profile);
            Title = Native.Text(info.Title);
            Caution = Native.Text(info.Caution);
        }

        public uint Number { get; }
        public bool IsSimulated { get; }
        public string Label { get; }
        public string Profile { get; }
        public string Title { get; }
        /// <summary>What to check before the first motion. May be empty.</summary>
        public string Caution { get; }

        void Check(int status) => Native.Check(status, handle, Native.pp_axis_error);

        public double Get(string name)
        {
            byte[] bytes = Native.Bytes(name);
            Check(Native.pp_axis_get(handle, bytes, Native.Length(bytes), out double value));
            return value;
        }

        public long GetRaw(string name)
        {
            byte[] bytes = Native.Bytes(name);
            Check(Native.pp_axis_get_raw(handle, bytes, Native.Length(bytes), out long value));
            return value;
        }

        public string GetText(string name)
        {
            byte[] bytes = Native.Bytes(name), buffer = new byte[128];
            UIntPtr needed;
            int status;
            while ((status = Native.pp_axis_get_text(handle, bytes, Native.Length(bytes), buffer,
                       Native.Length(buffer), out needed)) == (int)Status.Buffer)
                buffer = new byte[(int)needed + 1];
            Check(status);
            return Encoding.UTF8.GetString(buffer, 0, (int)needed);
        }

        public void Set(string name, double value)
        {
            byte[] bytes = Native.Bytes(name);
            Check(Native.pp_axis_set(handle, bytes, Native.Length(bytes), value));
        }

        public void Set(string name, string value, bool store = false)
        {
            byte[] bytes = Native.Bytes(name), text = Native.Bytes(value);
            Check(Native.pp_axis_set_text(handle, bytes, Native.Length(bytes), text, Native.Length(text), store ? 1 : 0));
        }

        public void SetRaw(string name, long value, bool store = false)
        {
            byte[] bytes = Native.Bytes(name);
            Check(Native.pp_axis_set_raw(handle, bytes, Native.Length(bytes), value, store ? 1 : 0));
        }

        /// <summary>Sends a request in the protocol's own text.</summary>
        public long Send(string text)
        {
            byte[] bytes = Native.Bytes(text);
            Check(Native.pp_axis_send(handle, bytes, Native.Length(bytes), out long value));
            return value;
        }

        public List<Parameter> Parameters()
        {
            Check(Native.pp_axis_parameter_count(handle, out UIntPtr count));
            var all = new List<Parameter>();
            for (uint at = 0; at < (uint)count; at++)
            {
                var its = new Native.Parameter { Size = (uint)Marshal.SizeOf(typeof(Native.Parameter)) };
                Check(Native.pp_axis_parameter_at(handle, (UIntPtr)at, ref its));
                all.Add(new Parameter(its));
            }
            return all;
        }

        public bool HasSignal(Signal signal)
        {
            Check(Native.pp_axis_has_signal(handle, signal, out int has));
            return has != 0;
        }

        public double Read(Signal signal)
        {
            Check(Native.pp_axis_read(handle, signal, out double value));
            return value;
        }

        public Trace Trace(IList<Signal> signals, double period)
        {
            var numbers = new int[signals.Count];
            for (int i = 0; i < numbers.Length; i++)
                numbers[i] = (int)signals[i];
            Check(Native.pp_axis_trace(handle, numbers, (UIntPtr)numbers.Length, period, out IntPtr trace));
            return new Trace(trace, numbers.Length);
        }

        public void Arm() => Check(Native.pp_axis_arm(handle));
        /// <summary>Stops, disables and disarms.</summary>
        public void Release() => Check(Native.pp_axis_release(handle));
        public void Stop() => Check(Native.pp_axis_stop(handle));
        public void Enable() => Run(Verb.Enable);
        public void Disable() => Run(Verb.Disable);
        public void Clear() => Run(Verb.Clear);
        public void Home() => Run(Verb.Home);
        public void Velocity(string speed) => Run(Verb.Velocity, speed);
        public void Velocity(double speed) => Run(Verb.Velocity, speed);
        public void MoveTo(string position) => Run(Verb.MoveTo, position);
        public void MoveTo(double position) => Run(Verb.MoveTo, position);
        public void MoveBy(string distance) => Run(Verb.MoveBy, distance);
        public void MoveBy(double distance) => Run(Verb.MoveBy, distance);

        public void Run(Verb verb, double target = double.NaN) =>
            Check(Native.pp_axis_run(handle, verb, target, IntPtr.Zero));

        public void Run(Verb verb, string target)
        {
            byte[] bytes = Native.Bytes(target);
            Check(Native.pp_axis_run_text(handle, verb, bytes, Native.Length(bytes), IntPtr.Zero));
        }

        public Request Begin(Verb verb, double target = double.NaN)
        {
            Check(Native.pp_axis_begin(handle, verb, target, IntPtr.Zero, out IntPtr request));
            return new Request(request);
        }

        /// <summary>Waits until a move has reached its target.</summary>
        public void Wait(double seconds) => Check(Native.pp_axis_wait(handle, seconds));

        /// <summary>Arms and enables the axis until the result is disposed of.</summary>
        public IDisposable Armed() => new ArmedScope(this);

        public void Dispose()
        {
            Native.pp_axis_close(handle);
            handle = IntPtr.Zero;
        }

        sealed class ArmedScope : IDisposable
        {
            readonly Axis axis;

            internal ArmedScope(Axis axis)
            {
                this.axis = axis;
                axis.Arm();
                try
                {
                    axis.Enable();
                }
                catch (PolepairException error)
                {
                    // A drive without a switch for its power is only armed.
                    if (error.Code != "E218")
                    {
                        Native.pp_axis_release(axis.handle);
                        throw;
                    }
                }
            }

            public void Dispose() => axis.Release();
        }
    }

    /// <summary>A link: a wire, a simulation, or the axes of a running server.</summary>
    public sealed class Link : IDisposable
    {
        IntPtr handle;

        public Link(string url)
        {
            byte[] bytes = Native.Bytes(url);
            int status = Native.pp_link_open(bytes, Native.Length(bytes), out handle);
            if (status != 0)
            {
                Native.Error error = Native.NewError();
                Native.pp_link_error(handle, ref error);
                Native.Error ignored = Native.NewError();
                Native.pp_link_close(handle, ref ignored);
                throw new PolepairException(error);
            }
        }

        void Check(int status) => Native.Check(status, handle, Native.pp_link_error);

        public int AxisCount
        {
            get
            {
                Check(Native.pp_link_axis_count(handle, out UIntPtr count));
                return (int)count;
            }
        }

        public Axis AxisAt(int index)
        {
            Check(Native.pp_link_axis_at(handle, (UIntPtr)index, out IntPtr axis));
            return new Axis(axis);
        }

        public Axis Axis(string name)
        {
            byte[] bytes = Native.Bytes(name);
            Check(Native.pp_link_axis(handle, bytes, Native.Length(bytes), out IntPtr axis));
            return new Axis(axis);
        }

        public void StopAll() => Check(Native.pp_link_stop_all(handle));

        /// <summary>Waits on the link's clock.</summary>
        public void Sleep(double seconds) => Check(Native.pp_link_sleep(handle, seconds));

        /// <summary>Does something to a simulated drive: "supply=18".</summary>
        public void Act(int drive, string act)
        {
            byte[] bytes = Native.Bytes(act);
            Check(Native.pp_simulation_act(handle, (UIntPtr)drive, bytes, Native.Length(bytes)));
        }

        /// <summary>Scans a wire for drives, by reads only.</summary>
        public static List<FoundDrive> Scan(string url, uint first, uint last)
        {
            byte[] bytes = Native.Bytes(url);
            int status = Native.pp_scan_open(bytes, Native.Length(bytes), first, last, out IntPtr scan);
            try
            {
                Native.Check(status, scan, Native.pp_scan_error);
                var all = new List<FoundDrive>();
                Native.Check(Native.pp_scan_count(scan, out UIntPtr count), scan, Native.pp_scan_error);
                for (uint at = 0; at < (uint)count; at++)
                {
                    var found = new Native.Found { Size = (uint)Marshal.SizeOf(typeof(Native.Found)) };
                    Native.Check(Native.pp_scan_at(scan, (UIntPtr)at, ref found), scan, Native.pp_scan_error);
                    all.Add(new FoundDrive(found));
                }
                return all;
            }
            finally
            {
                Native.pp_scan_close(scan);
            }
        }

        /// <summary>Stops what is armed, and closes the link.</summary>
        public void Dispose()
        {
            if (handle == IntPtr.Zero)
                return;
            Native.Error error = Native.NewError();
            int status = Native.pp_link_close(handle, ref error);
            handle = IntPtr.Zero;
            if (status != 0)
                throw new PolepairException(error);
        }
    }
}
