"""The text of an exported filter: header, source, test program, Makefile."""

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sigmax.engine.lowered import TOLD
from sigmax.export.c99 import c_function, count
from sigmax.native.pieces import Program
from sigmax.steps.step import Fault


class Names(NamedTuple):
    """What things are called in C.

    Attributes:
        prefix: of all that the header declares.
        state: numbers of the state.
        deviations: rows of its covariance.
        sensors: by the sensor's name, the numbers that it measures.
        residuals: by the sensor's name, the numbers of a difference of two of its measurements.
        inputs: how many inputs there are.
        rest: numbers behind mean and factor, of a filter of several beliefs.
        modes: of a model that has them, whose logarithms of probabilities are the last of the rest.
        noises: that a filter finds as it goes: first of the rest stand those of R, then for each group of Q the
            logarithm of its number and what it is found by.
    """

    prefix: str
    state: tuple[str, ...]
    deviations: tuple[str, ...]
    sensors: Mapping[str, tuple[str, ...]]
    residuals: Mapping[str, tuple[str, ...]]
    inputs: int
    rest: int = 0
    modes: tuple[str, ...] = ()
    noises: tuple[str, ...] = ()

    @property
    def points(self) -> int:
        """Numbers of the state."""
        return len(self.state)

    @property
    def n(self) -> int:
        """Rows of the covariance."""
        return len(self.deviations)

    @property
    def triangle(self) -> int:
        """Numbers of its factor."""
        return self.n * (self.n + 1) // 2

    def update(self, sensor: str) -> str:
        """The name of the function that corrects with a sensor."""
        return f"{self.prefix}_update{f'_{identifier(sensor)}' if sensor else ''}"

    def of_state(self, place: int) -> str:
        """The name of a number of the row that a belief is kept in."""
        if place >= self.points + self.triangle:
            return f"rest_{place - self.points - self.triangle}"
        if place < self.points:
            return f"x_{self.state[place]}"
        i, j = (int(a[place - self.points]) for a in np.tril_indices(self.n))
        return f"S_{self.deviations[i]}__{self.deviations[j]}"


def identifiers(names: Sequence[str]) -> tuple[str, ...]:
    """Names as C allows them, all different."""
    made = [identifier(name) for name in names]
    return tuple(f"{name}_{i}" if made.count(name) > 1 else name for i, name in enumerate(made))


def identifier(name: str) -> str:
    """A name as C allows it."""
    made = re.sub(r"\W", "_", name, flags=re.ASCII)
    return made if made and not made[0].isdigit() else f"_{made}"


def header(names: Names, about: str, single: bool) -> str:
    """The header, with the settings at its head."""
    real, p, n = "float" if single else "double", names.prefix, names.n
    guard = f"{p.upper()}_H"
    faults = "\n".join(
        f"    {p.upper()}_{f.name} = {int(f)}{',' if f is not list(Fault)[-1] else ''} /* {f.message} */" for f in Fault
    )
    places = ", ".join(f"{p.upper()}_{name.upper()}" for name in names.state)
    given = _inputs_argument(names, real)
    lines = [
        comment(about),
        f"#ifndef {guard}\n#define {guard}\n",
        f"/* Places of the components in the mean. */\nenum {{ {places} }};\n",
        f"/* What the functions return: 0; above 0 why the step was not made, the state stays as it was then;\n"
        f"   below 0 that it was made without the negative weights of the sigma set. */\n"
        f"enum {{\n{faults}\n}};\n",
        "/* What is known: P = S S', S lower triangular with its rows one after the other. */\n"
        f"typedef struct {{\n    {real} mean[{names.points}]; /* {', '.join(names.state)} */\n"
        f"    {real} factor[{names.triangle}];{_of_rows(names)}\n{_rest(names, real)}}} {p}_state;\n",
        f"/* Begin with a mean and a covariance, its rows one after the other; 1 where that is none. */\n"
        f"int {p}_start({p}_state *s, const {real} mean[{names.points}], const {real} cov[{n * n}]);\n",
        f"/* Move on by dt seconds. */\nint {p}_predict({p}_state *s, {real} dt{given});\n",
    ]
    for sensor, parts in names.sensors.items():
        m, kind, residual = len(parts), f"{names.update(sensor)}_told", names.residuals[sensor]
        dim = len(residual)
        lines.append(
            f"/* What a measurement said; NAN in the residual where a component was missing. */\n"
            f"typedef struct {{\n    {real} nis; /* normalised innovation squared */\n    {real} log_likelihood;\n"
            f"    {real} dof; /* components seen and used */\n    {real} residual[{dim}]; /* {', '.join(residual)} */\n"
            f"    {real} factor[{dim * dim}]; /* of its covariance, lower triangular */\n}} {kind};\n\n"
            f"/* Correct with {', '.join(parts)}; NAN is missing. `told` may be NULL. */\n"
            f"int {names.update(sensor)}({p}_state *s, const {real} z[{m}]{given}, {kind} *told);\n"
        )
    return "\n".join([*lines, "#endif"]) + "\n"


def source(names: Names, programs: Mapping[str, Program], about: str, single: bool) -> str:
    """The source: the straight lines, and the functions of the header around them."""
    real, p, size = "float" if single else "double", names.prefix, names.points + names.triangle + names.rest
    lines = [comment(about), f'#include "{p}.h"\n\n#include <math.h>\n#include <stddef.h>\n']
    lines += _rows(names, real)
    lines += c_function(programs["start"], "begin", single, lambda g, i: f"given_{i}")
    lines += ["", *_start(names, real, size)]
    lines.append(f"\n/* A step: {count(programs['predict'])}. */")
    lines += c_function(programs["predict"], "predict", single, _naming(names, ["dt"]))
    lines += [
        f"\nint {p}_predict({p}_state *s, {real} dt{_inputs_argument(names, real)}) {{",
        f"    {real} row[{size}], next[{size}], given[{1 + names.inputs}], told[1];",
        "    given[0] = dt;",
        *_copied_inputs(names, 1),
        "    row_of(s, row);\n    predict(row, given, next, told);\n    of_row(next, s);",
        "    return (int)told[0];\n}",
    ]
    for sensor, parts in names.sensors.items():
        m, dim, name = len(parts), len(names.residuals[sensor]), f"correct{f'_{identifier(sensor)}' if sensor else ''}"
        program = programs[sensor]
        lines.append(f"\n/* A step: {count(program)}. */")
        lines += c_function(program, name, single, _naming(names, [f"z_{part}" for part in parts]))
        head = len(TOLD)
        lines += [
            f"\nint {names.update(sensor)}({p}_state *s, const {real} z[{m}]{_inputs_argument(names, real)}, "
            f"{names.update(sensor)}_told *told) {{",
            f"    {real} row[{size}], next[{size}], given[{m + names.inputs}], said[{head + dim + dim * dim}];",
            "    int i;",
            f"    for (i = 0; i < {m}; i++) given[i] = z[i];",
            *_copied_inputs(names, m),
            f"    row_of(s, row);\n    {name}(row, given, next, said);\n    of_row(next, s);",
            "    if (told != NULL) {\n        told->nis = said[0];\n        told->log_likelihood = said[1];",
            f"        told->dof = said[2];\n        for (i = 0; i < {dim}; i++) told->residual[i] = said[{head} + i];",
            f"        for (i = 0; i < {dim * dim}; i++) told->factor[i] = said[{head + dim} + i];\n    }}",
            "    return (int)said[3];\n}",
        ]
    return "\n".join(lines) + "\n"


def _of_rows(names: Names) -> str:
    """What the rows of the factor are of, where they are not of the numbers of the mean."""
    return "" if names.deviations == names.state else f" /* of {', '.join(names.deviations)} */"


def _rest(names: Names, real: str) -> str:
    """What a state holds of several beliefs, told by name as far as it is of use."""
    if not names.rest:
        return ""
    if names.noises:
        return f"    {real} rest[{names.rest}]; /* what is known of noises: {', '.join(names.noises)} */\n"
    last = f"the last {len(names.modes)}: log probabilities of {', '.join(names.modes)}" if names.modes else "members"
    return f"    {real} rest[{names.rest}]; /* the beliefs behind; {last} */\n"


def _naming(names: Names, given: Sequence[str]) -> Any:
    def name(group: str, place: int) -> str:
        if group == "state":
            return names.of_state(place)
        return given[place] if place < len(given) else f"u_{place - len(given)}"

    return name


def _inputs_argument(names: Names, real: str) -> str:
    return f", const {real} u[{names.inputs}]" if names.inputs else ""


def _copied_inputs(names: Names, after: int) -> list[str]:
    return [f"    given[{after + i}] = u[{i}];" for i in range(names.inputs)]


def _rows(names: Names, real: str) -> list[str]:
    parts = [("mean", names.points), ("factor", names.triangle), *([("rest", names.rest)] if names.rest else [])]
    there, back, at = [], [], 0
    for part, size in parts:
        there.append(f"    for (i = 0; i < {size}; i++) row[{at} + i] = s->{part}[i];")
        back.append(f"    for (i = 0; i < {size}; i++) s->{part}[i] = row[{at} + i];")
        at += size
    state = f"{names.prefix}_state"
    return [
        f"static void row_of(const {state} *s, {real} *row) {{\n    int i;",
        *there,
        "}\n",
        f"static void of_row(const {real} *row, {state} *s) {{\n    int i;",
        *back,
        "}\n",
    ]


def _start(names: Names, real: str, size: int) -> list[str]:
    n, points = names.n, names.points
    return [
        f"int {names.prefix}_start({names.prefix}_state *s, const {real} mean[{points}], const {real} cov[{n * n}]) {{",
        f"    {real} given[{size}], row[{size}], sound[1], *next = given;\n    int i, j;",
        f"    for (i = 0; i < {points}; i++) *next++ = mean[i];",
        f"    for (i = 0; i < {n}; i++)\n        for (j = 0; j <= i; j++) *next++ = cov[i * {n} + j];",
        "    begin(given, row, sound);\n    of_row(row, s);\n    return sound[0] == 0;\n}",
    ]


def comment(text: str) -> str:
    """A text as a comment, wrapped."""
    wrapped = [line for part in text.splitlines() for line in (textwrap.wrap(part, 106) or [""])]
    return "/* " + "\n   ".join(wrapped) + " */\n"
