"""The report: one self-contained HTML page of a run, its plots by uPlot (MIT, bundled), its 3-D view a canvas."""
