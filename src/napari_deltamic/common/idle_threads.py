"""How idle threads wait; must be imported before torch.

Idle threads of torch's OpenMP spin by default, and so keep our own loops off the cores: measured 3
to 10 times slower while another program runs. An environment that sets OMP_WAIT_POLICY itself is
left alone.
"""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
