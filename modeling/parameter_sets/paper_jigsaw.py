"""The jigsaw of the paper.

Source of every line: Apati, Hegedus, Hajdu, "Linear cutting force model to predict battery runtime of
jigsaws", MSSP, 10.1016/j.ymssp.2025.113229. Where table and appendix disagree the comment says which value
holds and why.
"""

from __future__ import annotations

from modeling.batteries.eq16 import Eq16Battery
from modeling.cutting_forces.linear import LinearCutting
from modeling.parameters import JigsawParameters

CRANK_SPEED_FULL_HZ = 42.08  # Appendix B, n_em
CRANK_SPEED_SET_HZ = 18.41  # Appendix B, n_ea
DUTY = CRANK_SPEED_SET_HZ / CRANK_SPEED_FULL_HZ  # Appendix B, PWM
NOMINAL_VOLTAGE_V = 18.0  # Table 3, U_0
MOTOR_VOLTAGE_V = NOMINAL_VOLTAGE_V * DUTY  # Appendix B, U_m
CUTOFF_SOC = 0.2  # section 4.3

PARAMETERS = JigsawParameters(
    resistance_ohm=0.176,  # Table 3
    inductance_h=3.21e-3,  # Table 3
    back_emf_constant_v_s_per_rad=7.383e-3,  # Table 3
    torque_constant_n_m_per_a=5.632e-3,  # Appendix B; Table 3 prints e-6, with which the motor cannot turn
    rotor_inertia_kg_m2=2.4e-5,  # Table 3
    yoke_inertia_kg_m2=2.38e-5,  # Table 3
    reciprocating_mass_kg=0.239,  # Table 3
    crank_radius_m=0.01,  # Table 3
    motor_damping_n_m_s_per_rad=3.4274e-6,  # Table 3
    gear_ratio=56.0 / 6.0,  # Table 3, k_mc = 6/56
    mechanism="scotch_yoke",  # section 3
)

BATTERY = Eq16Battery(
    nominal_voltage_v=NOMINAL_VOLTAGE_V,
    capacity_ah=1.5,  # Appendix B, Q_b; Appendix A's 2.5 Ah does not give the published runtime
    beta=0.99,  # not printed: with 0.02 Ohm and a held motor voltage it gives the published 927 s
    internal_resistance_ohm=0.02,  # not printed: see beta
)

CUTTING = LinearCutting(
    k_fc_n_s_per_m=240.29,  # Appendix B, d_Fc_opt
    cutting_half="pi_to_2pi",  # section 4.1; the start-up peak of 34.73 A needs this reading, not Eq. 9's
)
