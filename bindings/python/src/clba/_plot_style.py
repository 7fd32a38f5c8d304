# SPDX-License-Identifier: Apache-2.0
"""Colours of the plots: Okabe and Ito's vermillion and blue, which colour-blind readers can tell
apart, with a tint and a shade of each."""

LINE = {"before": "#d55e00", "after": "#0072b2"}
TINT = {"before": "#efb48c", "after": "#85bbdc"}
DARK = {"before": "#7a3600", "after": "#003a5c"}
INK = "#222222"
MUTED = "#6b7280"
GRID = "#e5e7eb"
