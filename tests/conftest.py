"""What holds for all tests."""

import os

# Tests run in several processes, one for each core: a pool of threads in each of them, for matrices as small as these,
# would only wait for the others'. It must be said before NumPy is imported; commands that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
