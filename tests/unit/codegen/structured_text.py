"""Structured Text run in Python: enough of IEC 61131-3 for what is exported, read from the text alone.

Every statement of the text becomes one of Python; whatever this does not know is an error.
"""

import math
import re

import numpy as np

FUNCTIONS = {
    "SQRT": math.sqrt, "SIN": math.sin, "COS": math.cos, "TAN": math.tan, "ASIN": math.asin, "ACOS": math.acos,
    "ATAN": math.atan, "EXP": math.exp, "LN": math.log, "ABS": abs, "EXPT": math.pow, "TRUNC": int,
    "LINT_TO_DINT": int, "DINT_TO_LINT": int, "LINT_TO_LREAL": float, "LINT_TO_REAL": np.float32,
}  # fmt: skip
POU = re.compile(r"(FUNCTION_BLOCK|FUNCTION) (\w+)(?: : (\w+))?\n(.*?)END_\1", re.DOTALL)
SECTION = re.compile(r"(VAR_INPUT|VAR_OUTPUT|VAR_IN_OUT|VAR CONSTANT|VAR)\n(.*?)END_VAR\n", re.DOTALL)
DECLARATION = re.compile(r"([\w, ]+) : (ARRAY\[0\.\.(\d+)\] OF )?(\w+)(?: := (.*?))?;", re.DOTALL)
START = {"LREAL": 0.0, "REAL": np.float32(0.0), "LINT": 0, "DINT": 0, "BOOL": False}


def expression(text):
    text = re.sub(r"(?<![<>:!=])=(?!=)", "==", text.replace("<>", "!="))
    for word, meaning in (("AND", "and"), ("OR", "or"), ("NOT", "not"), ("MOD", "%"), ("TRUE", "True")):
        text = re.sub(rf"\b{word}\b", meaning, text)
    return text


def number(kind, text):
    return np.float32(text) if kind == "REAL" else float(text) if kind == "LREAL" else int(text)


def declared(text):
    """Variables of a program unit by section: name -> (type, size or None, start)."""
    found = {}
    for section, inside in SECTION.findall(text):
        names = found.setdefault(section, {})
        for group, _, last, kind, start in DECLARATION.findall(inside):
            if last:
                cells = re.findall(r"[^\s,\[\]]+", start) or ["0"] * (int(last) + 1)
                assert len(cells) == int(last) + 1
                value = [number(kind, cell) for cell in cells]
            else:
                value = number(kind, start) if start else START[kind]
            names |= {name.strip(): value for name in group.split(",")}
        assert not DECLARATION.sub("", inside).strip(), inside
    return found


def statements(text, name, real):
    """Lines of Python for the statements of a body; constants of a REAL block are single precision."""
    lines, depth = [], 1
    for raw in filter(None, map(str.strip, text.splitlines())):
        line = re.sub(r"(?<![\w.])(\d+\.\d+(?:E[+-]?\d+)?)", r"np.float32(\1)", raw) if real == "REAL" else raw
        before, after = 0, 0
        if match := re.fullmatch(r"IF (.*) THEN", line):
            made, after = f"if {expression(match[1])}:", 1
        elif match := re.fullmatch(r"ELSIF (.*) THEN", line):
            made, before, after = f"elif {expression(match[1])}:", -1, 1
        elif line == "ELSE":
            made, before, after = "else:", -1, 1
        elif match := re.fullmatch(r"FOR (\w+) := (.*) TO (.*?)(?: BY (-?\d+))? DO", line):
            step = int(match[4] or 1)
            start, last = expression(match[2]), expression(match[3])
            made, after = f"for {match[1]} in range({start}, ({last}) + {1 if step > 0 else -1}, {step}):", 1
        elif line in ("END_IF;", "END_FOR;"):
            made, before = "pass", 0
            lines.append("    " * depth + made)
            depth -= 1
            continue
        elif line == "EXIT;":
            made = "break"
        elif line == "RETURN;":
            made = f"return {name}"
        else:
            match = re.fullmatch(r"(\w+(?:\[[^:]*\])?) := (.*);", line)
            assert match, raw
            made = f"{expression(match[1])} = {expression(match[2])}"
        depth += before
        lines.append("    " * depth + made)
        depth += after
    assert depth == 1
    return lines


class Blocks:
    """The function blocks of a text, ready to run."""

    def __init__(self, text):
        text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
        self.space, self.blocks = {**FUNCTIONS, "np": np}, {}
        for kind, name, result, inside in POU.findall(text):
            variables = declared(inside)
            real = "REAL" if "REAL" in re.split(r"\W+", inside + str(result)) else "LREAL"
            body = statements(SECTION.sub("", inside), name, real)
            if kind == "FUNCTION_BLOCK":
                self.blocks[name] = (variables, body)
                continue
            inputs = [*variables.get("VAR_INPUT", {}), *variables.get("VAR_IN_OUT", {})]
            source = [f"def {name}({', '.join(inputs)}):", *body, f"    return {name}"]
            exec("\n".join(source), self.space)
        assert not POU.sub("", text).strip()

    def run(self, name, start, *inputs):
        """Output of the block ``name`` for each row of its inputs."""
        variables, body = self.blocks[name]
        (output,) = variables["VAR_OUTPUT"]
        kept = {key: value for section in variables.values() for key, value in section.items()}
        order = list(variables["VAR_INPUT"])[1:]
        code = compile("\n".join(line[4:] for line in body), name, "exec")
        state, kind, found = {**self.space, **kept}, type(kept[output]), []
        for new, *row in zip(start, *inputs, strict=True):
            state |= {"reset": bool(new), **{key: kind(value) for key, value in zip(order, row, strict=True)}}
            exec(code, state)
            found.append(state[output])
        return np.array(found)
