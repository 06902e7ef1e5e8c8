"""How idle threads wait; must be imported before torch.

Those of torch's OpenMP by default spin, and so keep the cores from our own loops: measured 3 to 10
times slower while another program runs. An environment that sets OMP_WAIT_POLICY itself is left
alone.
"""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
