"""One thread of linear algebra per process, set before numpy is loaded and handed on to every process that a test starts.

Two workers share the cores already: a thread of one would spin while the other holds its core, eight times the work for
small matrices.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
