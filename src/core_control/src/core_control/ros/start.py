# SPDX-License-Identifier: BSD-3-Clause
"""Start of a node: read its parameters or refuse with one line and exit code 2."""

from __future__ import annotations

import sys

import rospy

from core_control.exceptions import ParameterError

EXIT_BAD_PARAMETER = 2


def read_node_parameters(params_class):
    """Checked parameters of this node's private namespace.

    Prints one line on stderr that names node, key, value and what is allowed, and exits with code 2, where one is wrong
    or unknown.
    """
    values = rospy.get_param("~", {}) if rospy.has_param("~") else {}
    try:
        return params_class.from_dict(values)
    except ParameterError as error:
        sys.stderr.write(f"{rospy.get_name()}: parameter ~{error}\n")
        sys.stderr.flush()
        sys.exit(EXIT_BAD_PARAMETER)
