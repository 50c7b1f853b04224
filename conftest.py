"""One thread for linear algebra, as `sawbench diagnose` has it: small products, and two workers share the cores."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
