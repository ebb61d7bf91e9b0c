"""A figure for a paper, and the pictures of a whole report, as matplotlib objects."""

from emps_design import design_velocity_loop, machine
from emps_design.report import assemble_report, velocity_loop_figures

axis = machine("emps2018")
design = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0)

figures = velocity_loop_figures(design)
print(", ".join(figures))

bode = figures["bode_plant_input"]
bode.axes[0].set_title("Velocity loop of the paper")
bode.savefig("bode.pdf")

page = assemble_report(axis, crossover=100.0).page
for picture in page.pictures():
    print(f"{picture.title}: {type(picture.figure).__module__}.{type(picture.figure).__name__}")
