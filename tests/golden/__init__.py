"""Evidence that a change of the code's form changed nothing of what it does: `python -m tests.golden write DIR`, then `compare DIR`.

`entry.py` alone knows the modules of `monitor`; everything else goes through it or through the command line.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: the number of threads is in the last digits
