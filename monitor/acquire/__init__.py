"""Robot → Recording: guarded motion and listening, each in a child process that may die. All I/O."""
