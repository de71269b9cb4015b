"""The layout that comes along draws what is there, in live data and in recordings."""

import json

from hil_forceps.bridge.live.topics import TOPICS
from tools.generation.foxglove_layout import TARGET, main


def test_it_is_up_to_date() -> None:
    assert main(["--check"]) == 0


def test_every_path_is_a_field_of_a_topic() -> None:
    made = json.loads(TARGET.read_text(encoding="utf-8"))
    fields = {f"{topic.name}.{field.name.lower()}" for topic in TOPICS for field in topic.fields}
    schemas = {f"{topic.name}.{line.split()[1]}" for topic in TOPICS for line in topic.schema.splitlines()}
    paths = [path["value"] for config in made["configById"].values() for path in config["paths"]]
    assert len(paths) > 12
    assert set(paths) <= fields == schemas


def test_every_panel_stands_somewhere() -> None:
    made = json.loads(TARGET.read_text(encoding="utf-8"))

    def leaves(node: object) -> list[str]:
        if isinstance(node, dict):
            return leaves(node["first"]) + leaves(node["second"])
        return [str(node)]

    assert sorted(leaves(made["layout"])) == sorted(made["configById"])
