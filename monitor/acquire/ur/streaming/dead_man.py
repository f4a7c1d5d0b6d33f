"""The dead-man timer: the kernel ends this process when it does not report in time, whatever the process is doing.

A call of ur-rtde may block for minutes, and a machine may stop this process for a while. In both cases the arm has stopped by the time
that the process goes on, and the process must not send another target then. A thread could not see to that: it needs the interpreter, which
may be busy. So the kernel sends SIGALRM, whose default disposition ends the process before one more instruction of it runs.
"""

import signal


def watch() -> None:
    """Let SIGALRM end this process, also where the parent had it blocked or ignored."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})


def report_within(seconds: float) -> None:
    """End this process unless this function is called again within so many seconds; 0 takes the timer away."""
    signal.setitimer(signal.ITIMER_REAL, seconds)
