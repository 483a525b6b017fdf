# SPDX-License-Identifier: BSD-3-Clause
"""Services ``add_rule``, ``remove_rule``, ``list_rules`` of the node safety_reasoner."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Optional, Tuple

import rospy
from core_msgs.msg import OperatorRule
from core_msgs.srv import (
    AddRule,
    AddRuleResponse,
    ListRules,
    ListRulesResponse,
    RemoveRule,
    RemoveRuleResponse,
)

from core_perception.exceptions import PerceptionError
from core_perception.ontology import Ontology
from core_perception.operator_rules import OperatorRules, RuleKind
from core_perception.params import ReasonerParams
from core_perception.predicates import Constraints
from core_perception.ros.conversions import ns_to_stamp

NO_READER = "this reasoner reads no sentences; give a predicate such as 'AROUND(forklift, 1.5)=unsafe'"


class OperatorServices:
    """Rules of a person: kept, handed to the reasoner, merged into every statement.

    Their time is the stamp of the newest statement. A second clock beside it, a little behind, would look like one that
    goes back again and again, and each time a rule would lose a bit of its lifetime.
    """

    def __init__(self, params: ReasonerParams, ontology: Ontology, reads_guidelines: bool, lock):
        """Read the rules that were kept and offer the services.

        Args:
            params: where they are kept, and sentences given by parameter.
            ontology: canonical class names.
            reads_guidelines: the reasoner heeds sentences.
            lock: held while rules are read or changed.

        Raises:
            RuleError: the file of rules is damaged.
        """
        self._lock, self._reads_guidelines, self._given = lock, reads_guidelines, params.guidelines
        path = rules_path(params.operator_rules_file, rospy.get_name())
        self._now_s = _now_s()
        self._rules = OperatorRules(path, ontology.canonical, self._now_s)
        unread = self.guidelines()
        if unread and not reads_guidelines:
            rospy.logwarn("safety_reasoner: %d sentences are not heeded: %s", len(unread), NO_READER)
        rospy.Service("add_rule", AddRule, self._on_add)
        rospy.Service("remove_rule", RemoveRule, self._on_remove)
        rospy.Service("list_rules", ListRules, self._on_list)

    def merge(self, constraints: Constraints, now_ns: int) -> Constraints:
        """Return the statement that holds from now_ns on, with the operator's rules in it."""
        self._now_s = now_ns * 1e-9 or None
        return self._rules.merge(constraints, self._now_s)

    def guidelines(self) -> Tuple[str, ...]:
        """Sentences for the language model."""
        return (*self._given, *self._rules.guidelines(self._now_s))

    def count(self) -> int:
        """Return how many rules of the service are active."""
        return len(self._rules.active(self._now_s))

    def _on_add(self, request) -> AddRuleResponse:
        if request.kind not in (OperatorRule.PREDICATE, OperatorRule.GUIDELINE):
            return AddRuleResponse(False, "", f"kind: got {request.kind}, allowed 0 (predicate) or 1 (guideline)")
        kind = RuleKind.GUIDELINE if request.kind == OperatorRule.GUIDELINE else RuleKind.PREDICATE
        if kind == RuleKind.GUIDELINE and not self._reads_guidelines:
            return AddRuleResponse(False, "", NO_READER)
        try:
            with self._lock:
                rule = self._rules.add(request.text, kind, request.lifetime.to_sec(), self._now_s)
        except PerceptionError as error:
            return AddRuleResponse(False, "", str(error))
        until = "until it is removed" if rule.expires_s is None else f"for {request.lifetime.to_sec():g} s"
        return AddRuleResponse(True, rule.id, f"{rule.text} holds {until}")

    def _on_remove(self, request) -> RemoveRuleResponse:
        try:
            with self._lock:
                removed = self._rules.remove(request.id)
        except PerceptionError as error:
            return RemoveRuleResponse(False, str(error))
        return RemoveRuleResponse(removed, "removed" if removed else f"there is no rule {request.id!r}")

    def _on_list(self, _request) -> ListRulesResponse:
        with self._lock:
            rules = self._rules.active(self._now_s)
        return ListRulesResponse([_rule_to_msg(rule) for rule in rules])


def _now_s() -> Optional[float]:
    """ROS time [s]; None before the first message of a simulated clock."""
    return rospy.Time.now().to_sec() or None


def rules_path(parameter: str, node_name: str) -> Optional[Path]:
    """Return where rules are kept: ``auto`` is a file by node name under ROS_HOME; None to keep none."""
    if not parameter:
        return None
    if parameter != "auto":
        return Path(parameter)
    home = Path(os.environ.get("ROS_HOME", "~/.ros")).expanduser()
    return home / "core" / (node_name.strip("/").replace("/", ".") + ".rules.yaml")


def _rule_to_msg(rule) -> OperatorRule:
    kind = OperatorRule.GUIDELINE if rule.kind == RuleKind.GUIDELINE else OperatorRule.PREDICATE
    expires = rospy.Time() if rule.expires_s is None else ns_to_stamp(round(rule.expires_s * 1e9))
    return OperatorRule(rule.id, rule.text, kind, expires)
