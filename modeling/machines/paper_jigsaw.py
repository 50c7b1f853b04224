"""The jigsaw of the paper, as parts; every number and its source stand in `paper_jigsaw.toml`."""

from __future__ import annotations

from sawbench.modeling.machines.parameter_sets import parameter_set
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting

_CONFIG = parameter_set("paper_jigsaw").config
assert _CONFIG.plant is not None and _CONFIG.battery is not None

PARAMETERS = JigsawParameters.from_config(_CONFIG.plant)
BATTERY = Eq16Battery.from_config(_CONFIG.battery)
CUTOFF_SOC = _CONFIG.battery.cutoff_soc
NOMINAL_VOLTAGE_V = BATTERY.nominal_voltage_v
DUTY = 18.41 / 42.08  # Appendix B, n_ea / n_em, unrounded
MOTOR_VOLTAGE_V = NOMINAL_VOLTAGE_V * DUTY  # Appendix B, U_m
CUTTING = LinearCutting(k_fc_n_s_per_m=240.29, cutting_half=_CONFIG.cutting.cutting_half)  # Appendix B, d_Fc_opt
