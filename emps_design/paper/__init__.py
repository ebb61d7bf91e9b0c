"""The paper of 2018: what it prints, the derivations, where they differ, and its section III on a virtual bench."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.paper.virtual_bench import NUMBERS as NUMBERS
    from emps_design.paper.derivations import DerivationStep as DerivationStep, derivation as derivation
    from emps_design.paper.derivations.impedance import cost_of_printed as cost_of_printed
    from emps_design.paper.errata import Erratum as Erratum, find_errata as find_errata
    from emps_design.paper.virtual_bench import PRINTED as PRINTED, reproduce_section_3 as reproduce_section_3
    from emps_design.paper.virtual_bench import bend_of as bend_of
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
