from .errata import Erratum as Erratum, derivation as derivation, find_errata as find_errata
from .loops import cost_of_printed as cost_of_printed
from .model import DerivationStep as DerivationStep
from .virtual_bench import (
    NUMBERS as NUMBERS,
    PRINTED as PRINTED,
    bend_of as bend_of,
    reproduce_section_3 as reproduce_section_3,
)
