# SPDX-License-Identifier: BSD-3-Clause
"""The tests here build and start a real model server: they run before a release, not with every change."""

import os

collect_ignore_glob = [] if os.environ.get("CORE_RELEASE_TESTS") == "1" else ["*_test.py"]
