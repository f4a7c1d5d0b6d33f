"""A simulated controller of Universal Robots for the unmodified ur-rtde. Its physics and friction are its own, unknown to the monitor.

From below to above, each line imports only from the lines before it:

arguments · polyscope · faults · scenario · settings   what is simulated, what happens to it, and the checks of both
arm/                                                   the physics: bodies, friction, heat, wear, sensors, servo reference
controller/                                            modes, registers, programs, safety, scenario; no sockets, no wall clock
wire/                                                  RTDE, dashboard and ports 30001–30003 on a loopback address
stepped · commands · server · launch                   replays faster than real time, the command port, the process
remote · view                                          clients of the command port: for tests, the demo and the terminal
"""
