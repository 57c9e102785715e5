# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the tables of topics and parameters into README.md, from the tables that the nodes use.

python docs/tables.py            rewrite README.md
"""

import re
from pathlib import Path

from ros2_deepc.gateway.gateway_node import GatewayNode
from ros2_deepc.nodes.config import ROLES, node_class
from ros2_deepc.ros import topics
from ros2_deepc.ros.parameters import markdown

README = Path(__file__).parents[1] / "README.md"


def topic_table() -> str:
    """The topics as Markdown."""
    lines = ["| topic | type | from -> to | kept for late readers |", "|---|---|---|---|"]
    for topic in topics.ALL:
        kept = f"last {topic.depth}" if topic.latched else "-"
        lines.append(f"| `{topic.name}` | `{topic.type_name}` | {topic.path} | {kept} |")
    return "\n".join(lines)


def tables() -> dict[str, str]:
    """Every generated table by the name of its marker."""
    nodes = {role: node_class(role) for role in ROLES} | {"gateway": GatewayNode}
    return {"topics": topic_table()} | {role: markdown(node.parameters) for role, node in nodes.items()}


def filled(text: str) -> str:
    """``text`` with every table between its markers renewed."""
    for name, table in tables().items():
        pattern = rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)"
        text, count = re.subn(pattern, lambda m, t=table: f"{m[1]}{t}\n{m[2]}", text, flags=re.S)
        if count != 1:
            raise SystemExit(f"README.md needs the markers <!-- {name} --> and <!-- /{name} --> once, found {count}")
    return text


if __name__ == "__main__":
    README.write_text(filled(README.read_text(encoding="utf-8")), encoding="utf-8")
