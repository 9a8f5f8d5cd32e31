"""Vibrations over their frequency: amplitude and phase, and families of periodic motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fx_beam.results.vibrations import FrequencyResponse, PeriodicFamily
from fx_beam.scene.beam import Node
from fx_beam.validation import require

from .time_curves import Figure, figure, quantities, save


def frequency_response(
    response: FrequencyResponse,
    path: Path | str | None = None,
    components: Sequence[str] | None = None,
) -> Figure:
    """Picture of amplitudes and phases over the frequency of the load.

    Amplitudes have a logarithmic scale, with a panel for each unit.

    Parameters
    ----------
    response : FrequencyResponse
        Result of `fx_beam.frequency_response`.
    path : str or path, optional
        Picture to write; its ending gives the format.
    components : sequence of str, optional
        The components to draw, of `FrequencyResponse.names`; by default all that move.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    wanted = "what fx_beam.frequency_response returned"
    require(isinstance(response, FrequencyResponse), "response", response, wanted)
    if components is None:
        components = [name for name in response.names if response.component(name).any()]
    wanted = f"names to draw, of {list(response.names)}"
    fits = isinstance(components, Sequence) and not isinstance(components, str)
    require(fits and len(components) > 0, "components", components, wanted)
    values = {name: response.component(name) for name in components}
    units = {name: response.units[response.names.index(name)] for name in values}
    kinds = sorted(set(units.values()))
    fig, axes = figure(len(kinds) + 1, 1)
    for unit, ax in zip(kinds, axes[:, 0], strict=False):
        # Each curve has the same style in all panels; those of other units are empty here.
        shown = {
            name: abs(v) if units[name] == unit else np.full(len(v), np.nan)
            for name, v in values.items()
        }
        quantities(ax, response.frequencies, shown)
        ax.set(yscale="log", ylabel=f"amplitude [{unit}]")
    phases = {name: np.degrees(np.unwrap(np.angle(v))) for name, v in values.items()}
    last = axes[-1, 0]
    quantities(last, response.frequencies, phases)
    angles = np.concatenate(list(phases.values())) / 90
    first, end = np.floor(angles.min()), np.ceil(angles.max())
    last.set_yticks(90 * np.arange(first, end + 1, max(1, (end - first) // 4)))
    last.set(ylabel="phase [deg]", xlabel="frequency of the load [Hz]")
    low, high = response.frequencies.min(), response.frequencies.max()
    if 0 < 100 * low < high:
        for ax in axes[:, 0]:
            ax.set_xscale("log")
    if path is not None:
        save(fig, path)
    return fig


def response(
    families: PeriodicFamily | Mapping[str, PeriodicFamily],
    node: Node,
    component: str = "y",
    path: Path | str | None = None,
) -> Figure:
    """Picture of the amplitude of a node over the frequency of periodic motions.

    Stable motions have a line, unstable ones dots on a thin line.

    Parameters
    ----------
    families : PeriodicFamily or dict
        What `fx_beam.backbone` or `fx_beam.forced_response` returned, or several by their labels.
    node : Node
        A node of the scene.
    component : {"x", "y", "rotation"}
        Component of its motion.
    path : str or path, optional
        Picture to write; its ending gives the format.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    named = families if isinstance(families, Mapping) else {"": families}
    for family in named.values():
        wanted = "what fx_beam.backbone or fx_beam.forced_response returned"
        require(isinstance(family, PeriodicFamily), "response: families", family, wanted)
    fig, axes = figure(1, 1, height=3.5)
    ax = axes[0, 0]
    for label, family in named.items():
        f, a, stable = family.frequencies, family.amplitudes(node, component), family.stable
        style = {"linestyle": "--", "color": "0.4"} if family.free else {"linewidth": 1.5}
        (line,) = ax.plot(f, a, label=label or None, **style)
        if not stable.all():
            of = "unstable" if not label else f"{label}, unstable"
            ax.plot(
                f[~stable], a[~stable], "o", ms=4, mfc="white", color=line.get_color(), label=of
            )
    unit = "rad" if component == "rotation" else "m"
    ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude of {component} [{unit}]")
    if path is not None:
        save(fig, path)
    return fig
