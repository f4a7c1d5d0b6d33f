"""A simulated controller of Universal Robots for the unmodified ur-rtde. Its physics and friction are its own, unknown to the monitor.

From below to above, each line imports only from the lines before it:

polyscope · faults · scenario · settings   what is simulated, what happens to it, and the checks of both
arm/                                       the physics: bodies, friction, heat, wear, sensors, servo reference
machine/                                   clock and modes, moves, registers, journal and identity of a controller
program/                                   URScript, ur-rtde's control script and lists of steps: what plays on the machine
controller/                                the whole controller: programs, safety, faults, scenario; no sockets, no wall clock
cells/                                     production cells around the arm
wire/                                      RTDE, dashboard, Robot API and ports 30001–30003 on a loopback address
stepped · production · commands · server   recordings faster than real time, the command port, the process
launch · remote · view                     start, and clients of the command port: for tests, the demo and the terminal
"""
