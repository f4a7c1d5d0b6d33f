"""A UR controller made of software, for the unmodified ur-rtde wheel: its own physics, its own friction, known to no estimator.

settings → Controller (controller, program, scripts, dashboard, rtde: no sockets) around an Arm (physics, friction, thermal) seen
through Sensors; server and ports put it on a loopback address, commands and remote are the tests' and the demo's back door.
"""
