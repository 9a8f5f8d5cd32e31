"""The pendulum of against_exudyn.py in Exudyn, as a process that computes what it is asked for.

It runs in a Python that has exudyn, which need not have fx_beam. Each line on its input is a case
in JSON; the answer has the seconds from an empty system to the end of the motion, and the rows of
the tip.
"""

import json
import sys
from time import perf_counter

import exudyn
import numpy as np
from exudyn import itemInterface as items


def cable(system, length, section, elements):
    """Nodes and elements of an ANCF cable: no shear, cubic in position."""
    size = length / elements
    nodes = [
        system.AddNode(items.NodePoint2DSlope1(referenceCoordinates=[i * size, 0, 1, 0]))
        for i in range(elements + 1)
    ]
    return nodes, [
        system.AddObject(
            items.ObjectANCFCable2D(
                nodeNumbers=nodes[i : i + 2],
                length=size,
                massPerLength=section["rhoA"],
                bendingStiffness=section["EI"],
                axialStiffness=section["EA"],
            )
        )
        for i in range(elements)
    ]


def beam(system, length, section, elements, degree):
    """Nodes and elements of a geometrically exact beam with two or three nodes to an element."""
    size = length / elements
    nodes = [
        system.AddNode(items.NodeRigidBody2D(referenceCoordinates=[i * size / degree, 0, 0]))
        for i in range(elements * degree + 1)
    ]
    return nodes, [
        system.AddObject(
            items.ObjectBeamGeometricallyExact2D(
                nodeNumbers=nodes[i * degree : (i + 1) * degree + 1],
                length=size,
                massPerLength=section["rhoA"],
                crossSectionInertia=section["rhoI"],
                bendingStiffness=section["EI"],
                axialStiffness=section["EA"],
                shearStiffness=section["GA"],
            )
        )
        for i in range(elements)
    ]


def pendulum(case):
    """System of a case, and the sensor at its tip."""
    system = exudyn.SystemContainer().AddSystem()
    arguments = system, case["length"], case["section"], case["elements"]
    cables = case["kind"] == "cable"
    nodes, elements = cable(*arguments) if cables else beam(*arguments, case["degree"])
    for element in elements:
        marker = system.AddMarker(items.MarkerBodyMass(bodyNumber=element))
        weight = [0, -case["gravity"], 0]
        system.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=weight))
    ground = items.MarkerNodeCoordinate(
        nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0
    )
    fixed = system.AddMarker(ground)
    for coordinate in (0, 1):
        marker = items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate)
        ends = [fixed, system.AddMarker(marker)]
        system.AddObject(items.ObjectConnectorCoordinate(markerNumbers=ends))
    tip = items.SensorNode(
        nodeNumber=nodes[-1],
        storeInternal=True,
        writeToFile=False,
        outputVariableType=exudyn.OutputVariableType.Position,
    )
    return system, system.AddSensor(tip)


def settings(case):
    """Generalized alpha, with nothing written to files."""
    chosen = exudyn.SimulationSettings()
    chosen.timeIntegration.endTime = case["t_end"]
    chosen.timeIntegration.numberOfSteps = case["steps"]
    chosen.timeIntegration.newton.useModifiedNewton = case["modified Newton"]
    chosen.timeIntegration.generalizedAlpha.spectralRadius = case["spectral radius"]
    chosen.timeIntegration.verboseMode = 0
    chosen.linearSolver.solverType = getattr(exudyn.LinearSolverType, case["matrix"])
    chosen.solution.file.write = False
    chosen.solution.sensors.writePeriod = case["t_end"] / case["rows"]
    return chosen


def run(case):
    """Seconds and rows of the tip of a case."""
    clock = perf_counter()
    system, tip = pendulum(case)
    system.Assemble()
    solved = system.SolveDynamic(settings(case))
    rows = np.array(system.GetSensorStoredData(tip))
    seconds = perf_counter() - clock
    times = np.linspace(0, case["t_end"], case["rows"] + 1)
    stored = len(rows) == len(times) and abs(rows[:, 0] - times).max() < 1e-9
    return {"seconds": seconds, "tip": rows[:, 1:3].tolist() if solved and stored else None}


def main():
    # Exudyn itself writes to the output channel: answers begin with a sign of their own.
    print("=", json.dumps({"version": exudyn.__version__}), flush=True)
    for line in sys.stdin:
        print("=", json.dumps(run(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
