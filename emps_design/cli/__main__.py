"""``python -m emps_design.cli`` runs the command line."""

from emps_design.cli import main

main()
