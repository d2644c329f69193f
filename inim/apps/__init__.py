"""Applications of the core, one folder each: its logic, command, page and document.

To remove an application, delete its folder and its entry in `APPS`; for type checkers, also its
public function in `inim/__init__.py`.
"""

FIRST = "first steps"
OWN = "your own pictures and displays"
COMPARISONS = "comparisons"
INFORMATION = "information"
DEVELOPERS = "for developers of algorithms"
#: Groups of commands in the help, in order.
GROUPS = (FIRST, OWN, COMPARISONS, INFORMATION, DEVELOPERS)

#: Applications by folder: commands with their groups in the help, public functions of `inim` with
#: the modules below the folder, and documents with their classes in the folder's `document.py`.
APPS: dict[str, dict[str, dict[str, str]]] = {
    "bench": {"commands": {"bench": DEVELOPERS}, "documents": {"bench": "BenchDocument"}},
    "benchmark": {
        "commands": {"benchmark": COMPARISONS},
        "documents": {
            "benchmark_input": "InputDocument",
            "benchmark_case": "CaseDocument",
            "submission": "SubmissionDocument",
            "benchmark_result": "ResultDocument",
            "benchmark_board": "BoardDocument",
            "benchmark_statistics": "StatisticsDocument",
        },
    },
    "export": {"commands": {"view": FIRST, "export": OWN}, "functions": {"export": ".export"}},
    "inspect": {
        "commands": {"inspect": OWN},
        "functions": {"inspect": ".findings"},
        "documents": {"inspect": "InspectDocument"},
    },
    "own_picture": {
        "commands": {"generate": OWN},
        "functions": {"CameraFit": ".stream"},
        "documents": {"cameras": "CamerasDocument"},
    },
    "pickup": {"commands": {"pickup": OWN}, "functions": {"pickup": ".elemental_images"}},
    "stress": {"commands": {"stress": DEVELOPERS}, "documents": {"stress": "StressDocument"}},
    "sweep": {
        "commands": {"sweep": COMPARISONS},
        "functions": {"sweep": ".run"},
        "documents": {"sweep": "SweepDocument"},
    },
}

#: Modules of the applications' public functions.
FUNCTIONS = {
    function: f"inim.apps.{folder}{module}"
    for folder, app in APPS.items()
    for function, module in app.get("functions", {}).items()
}
