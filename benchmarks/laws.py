"""What ``law`` tells of the servo records: structure, gains against their deviations, filters; a table and a JSON file.

    python -m benchmarks.laws ../shared/data/servo --out benchmarks/laws.json [--only joint-none-0]
        [--parts train+holdout]

Rows of other cases and parts that the file has already stay; records joined by ``+`` are taken together. The truth is
the ``[controller]`` of each folder's axis file, which ``law`` does not read.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

WITHIN = {"gain": 0.03, "lowpass": 0.06, "notch": 0.03}  # asked for


def compare(found: dict[str, Any], true: dict[str, Any]) -> dict[str, Any]:
    """One row: whether the structure is right, the largest errors, and those errors over their deviations."""
    table = found["controller"]
    if table is None:
        return {"verdict": found["verdict"], "reason": found["reason"], "structure": False}
    gains, filters = {}, {"lowpass": 0.0, "notch": 0.0}
    for name in ("position.kp", "velocity.kp", "velocity.ti", *(f"feedforward.{n}" for n in true["feedforward"])):
        group, key = name.split(".")
        value, wanted = table.get(group, {}).get(key, 0.0), true[group][key]
        std = found["std"].get(group, {}).get(key)
        if wanted and value and std:
            gains[name] = (value / wanted - 1.0, (value - wanted) / std)
    same = [f["kind"] for f in table.get("filters", [])] == [f["kind"] for f in true["filters"]]
    for i, wanted in enumerate(true["filters"] if same else ()):
        value, std = table["filters"][i]["frequency"], found["std"]["filters"][i]["frequency"]
        filters[wanted["kind"]] = value / wanted["frequency"] - 1.0
        gains[f"{wanted['kind']}.frequency"] = (filters[wanted["kind"]], (value - wanted["frequency"]) / std)
    ahead = {name: value for name, value in true["feedforward"].items() if value}
    structure = (
        table["kind"] == true["kind"]
        and same
        and table.get("position", {}).get("every") == true["position"]["every"]
        and table["velocity"].get("form", "") == true["velocity"].get("form", "pi")
        and set(table.get("feedforward", {})) == set(ahead)
        and (ahead["velocity"] == 1.0) == (table["feedforward"].get("velocity") == 1.0)
        and table["velocity_estimator"] == "backward"
        and found["delay"] == 0
    )
    own = {name: pair for name, pair in gains.items() if not name.endswith(".frequency")}
    return {
        "verdict": found["verdict"],
        "structure": structure,
        "every": table.get("position", {}).get("every"),
        "largest_gain_error": max((abs(e) for e, _ in own.values()), default=0.0),
        "largest_error_in_std": max((abs(z) for _, z in gains.values()), default=0.0),
        "lowpass_error": filters["lowpass"],
        "notch_error": filters["notch"],
        "residual_rms": found["residual"]["rms"],
        "equivalents": len(found["equivalents"]),
    }


def main() -> None:
    """Print the table and write the file."""
    from emps_design.identification.controller import identify_law
    from emps_design.importing import import_record
    from emps_design.machines import load_axis

    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--parts", default="train,holdout")
    options = parser.parse_args()
    rows = json.loads(options.out.read_text())["rows"] if options.out and options.out.exists() else []
    for part in options.parts.split(","):
        for folder in sorted(path.parent for path in options.folder.glob("*/axis.toml")):
            if options.only not in folder.name:
                continue
            true = tomllib.loads((folder / "axis.toml").read_text())["controller"]
            axis = load_axis(str(folder / "axis.toml"))
            records = [import_record(folder / f"{one}.csv", axis) for one in part.split("+")]
            row = {"case": folder.name, "record": part, **compare(identify_law(records).to_dict(), true)}
            rows = [*(one for one in rows if (one["case"], one["record"]) != (folder.name, part)), row]
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in row.values()), flush=True)
            if options.out:
                document = {"date": datetime.now(UTC).date().isoformat(), "rows": rows}
                options.out.write_text(json.dumps(document, indent=1) + "\n")
    right = sum(row["structure"] for row in rows)
    print(f"{right} of {len(rows)} right structure")


if __name__ == "__main__":
    main()
