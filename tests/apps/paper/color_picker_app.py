# ruff: noqa
# fmt: off
# Port: modules that the printed program uses and does not import.
import json
import sys
from pathlib import Path

# For extracting colors from each plate
from tools.plate_color_analysis import get_colors_from_file

from solvers.evolutionary_solver import EvolutionaryColorSolver
from tools.globus_compute import Client  # Port: was globus_compute_sdk; there is no Globus here.
gcc = Client()

# For publishing to RPL Portal
from tools.publish_v2 import publish_iter

# For creating a payload that the OT2 will accept from the solver output
from tools.color_utils import convert_volumes_to_payload



# For running workflows, submits the job and waits for it to complete.
from labos.client.paper import run_flow  # Port: was tools.run_flow.

#For managing the overall experiment, generates a unique ID, handles logging and running flows. Is passed to the ruN_flow function to facillitate communication.
from labos.client.paper import Experiment  # Port: was rpl_wei.exp_app.

MAX_PLATE_SIZE = 96

def run(target_color, exp_budget, pop_size, address, port):  # Port: where the lab is.
    # workflows used
    wf_dir = Path(__file__).with_name("workflows")  # Port: was a folder of the authors' computer.
    init_workflow = wf_dir / "cp_wf_newplate.yaml"
    loop_workflow = wf_dir / "cp_wf_mixcolor.yaml"
    final_workflow = wf_dir / "cp_wf_trashplate.yaml"

    # Constants
    solver_out_dim = (pop_size, 3)

    # Resource Tracking:
    plate_n = 1  # total number of plates
    current_iter = 0  # total number of itertions
    num_exps = 0  # total number of wells used
    curr_wells_used = []  # list of all wells used

    # Information Tracking:
    current_plate = None
    cur_best_color = None
    cur_best_diff = float("inf")
    diffs = []  # List of all diffs from all runs of the experiment
    payload = {}  # Payload to be sent to the workflow runs

    #Globus Compute Setup:
    gc_endpoint = "299edea0-db9a-4693-84ba-babfa655b1be"

    # Initialize the Experiment: start logging on the server and create log files.
    # The events object it used to log important occurences in application execution.
    # Logging is also integrated in the run_flow and publish_iter functions
    exp = Experiment(address, port, "Color_Picker")  # Port: was "127.0.0.1", "8000".
    exp.register_exp()
    folder_path, dest_path = exp.experiment_path / "results", exp.experiment_path / "published"  # Port: named nowhere.

    # Step 1: Run first workflow, to get a new plate
    steps_run = []
    steps_run, _ = run_flow(init_workflow, payload, steps_run, exp)
    curr_wells_used = []

    # Step 2: Repeatedly mix and image colors
    exp.events.log_loop_start("Main Loop")
    while num_exps + pop_size <= exp_budget:
        # Step 2a: Calculate volumes and current wells for use in the OT2 protocol
        plate_volumes = EvolutionaryColorSolver.run_iteration(
            target_color,
            current_plate,
            pop_size=pop_size,
            out_dim=(pop_size, 3),
            return_volumes=True,
        )
        payload, curr_wells_used = convert_volumes_to_payload(plate_volumes, curr_wells_used)  # Port: was left out.

        # Step 2b: Run second workflow, to mix colors
        steps_run, run_info = run_flow(loop_workflow, payload, steps_run, exp)

        # Step 2c: Analyze image: output should be list [pop_size, 3]
        exp.events.log_globus_compute("get_color_from_file")
        img_path = run_info["hist"]["Take Picture"]["action_msg"]
        gc_result = gcc.run(get_colors_from_file,  gc_endpoint, img_path)
        plate_colors_ratios = gc_result.result()[1]

        # Swap BGR to RGB
        plate_colors_ratios = {a: b[::-1] for a, b in plate_colors_ratios.items()}

        # Find the colors to be processed by the solver
        current_plate = []  # Port: a comma behind it made a tuple of it.
        wells_used = []
        for well in payload["destination_wells"]:
            color = plate_colors_ratios[well]
            wells_used.append(well)
            current_plate.append(color)

        # save those and the initial colors, etc
        exp.events.log_local_compute("find_best_color")
        plate_best_color_ind, plate_diffs = EvolutionaryColorSolver._find_best_color(
            current_plate, target_color, cur_best_color
        )
        plate_best_color = current_plate[plate_best_color_ind]
        plate_best_diff = (  # Port: the bracket was missing.
            EvolutionaryColorSolver._color_diff(plate_best_color, target_color))
        diffs.append(plate_diffs)

        # Find best colors
        if plate_best_diff < cur_best_diff:
            cur_best_diff = plate_best_diff
            cur_best_color = plate_best_color

        # Step 2d: Record best colors
        report = {
            "best_color": cur_best_color,
            "best_diff": cur_best_diff
        }

        folder_path.mkdir(parents=True, exist_ok=True)  # Port: nobody made it.
        with open(folder_path / "report.txt", "w") as f:  # Port: was opened for reading.
            json.dump(report, f)
        publish_iter(folder_path, dest_path, exp)

        num_exps += pop_size  # Port: was left out.
        exp.events.log_loop_check(
            "Sufficient wells in experiment budget", num_exps + pop_size <= exp_budget
       )
    exp.events.log_loop_end()  # Port: was left out.

    # Step 3: Run third workflow
    steps_run, _ = run_flow(final_workflow, payload, steps_run, exp)  # Port: exp was left out.
    exp.events.end_experiment()
# Run the application. Arguments are:
#   Target color: RGB representation of target color
#   Experiment budget: Number of colors to mix and image in total
#   Population size: Number of colors to mix and image at a time
if __name__ == "__main__":  # Port: was run([120, 120, 120], 100, 10).
    run( [120, 120, 120], int(sys.argv[3]), int(sys.argv[4]), sys.argv[1], sys.argv[2] )
