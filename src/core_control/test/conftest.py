# SPDX-License-Identifier: BSD-3-Clause
"""Makes the shared helpers importable from wherever pytest is started."""

import importlib.util
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

# The library is also tested where there is no ROS.
NEED_ROS = ["test_bag_invariant.py", "test_conversions.py", "test_filter_fuzz.py"]
collect_ignore = [] if importlib.util.find_spec("rospy") else NEED_ROS
