from .derivations import DerivationStep as DerivationStep, derivation as derivation
from .derivations.impedance import cost_of_printed as cost_of_printed
from .errata import Erratum as Erratum, find_errata as find_errata
from .virtual_bench import (
    NUMBERS as NUMBERS,
    PRINTED as PRINTED,
    bend_of as bend_of,
    reproduce_section_3 as reproduce_section_3,
)
