"""PX4's parameters as its own simulation starts, and ArduPilot's parameters derived from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from alula.stages.sim_vehicle.ardupilot.parameters import TABLE as ARDUPILOT
from alula.stages.sim_vehicle.common.estimator import EXTERNAL, GPS
from alula.stages.sim_vehicle.common.parameters import ParamType

_I, _F = ParamType.INT32, ParamType.FLOAT
_NO_TIMEOUT_S = 1e9  # a set-point stays in force until the mode ends
_FULL_MAH = 3300.0  # capacity of the battery if BAT1_CAPACITY is not set
EV_HORIZONTAL, EV_VERTICAL, EV_VELOCITY, EV_YAW = 1, 2, 4, 8  # EKF2_EV_CTRL

TABLE: dict[str, tuple[ParamType, float]] = {
    "BAT1_CAPACITY": (_F, -1),  # mAh
    "BAT_CRIT_THR": (_F, 0.07),
    "BAT_EMERGEN_THR": (_F, 0.05),
    "BAT_LOW_THR": (_F, 0.15),
    "CAL_ACC0_ID": (_I, 1310988),
    "CAL_GYRO0_ID": (_I, 1310988),
    "CAL_MAG0_ID": (_I, 197388),
    "COM_ACT_FAIL_ACT": (_I, 0),  # 3: return
    "COM_DISARM_LAND": (_F, 2),  # s after a landing
    "COM_DISARM_PRFLT": (_F, 10),  # s without a take-off
    "COM_DL_LOSS_T": (_I, 10),  # s
    "COM_DLL_EXCEPT": (_I, 0),  # 2: in Auto modes, 4: in Offboard
    "COM_FAIL_ACT_T": (_F, 5),  # s of Hold before a failsafe's action
    "COM_FLTMODE1": (_I, -1),
    "COM_FLTMODE2": (_I, -1),
    "COM_FLTMODE3": (_I, -1),
    "COM_FLTMODE4": (_I, -1),
    "COM_FLTMODE5": (_I, -1),
    "COM_FLTMODE6": (_I, -1),
    "COM_FLTT_LOW_ACT": (_I, 0),  # 3: return; the remaining time is not estimated here
    "COM_FLT_TIME_MAX": (_I, -1),  # s, then it returns
    "COM_LOW_BAT_ACT": (_I, 3),  # 0: warn, 2: land, 3: return, land at the emergency level
    "COM_OBL_RC_ACT": (_I, 0),
    "COM_OF_LOSS_T": (_F, 1),  # s
    "COM_POSCTL_NAVL": (_I, 0),
    "COM_POS_LOW_ACT": (_I, 3),  # in Mission and Hold only
    "COM_RCL_EXCEPT": (_I, 0),  # 2: in Auto modes, 4: in Offboard
    "COM_RC_IN_MODE": (_I, 1),  # 4: no sticks at all
    "COM_RC_OVERRIDE": (_I, 1),  # 1: in Auto modes, 2: in Offboard
    "COM_RC_STICK_OV": (_F, 30),  # %
    "COM_SPOOLUP_TIME": (_F, 1),  # s
    "COM_WIND_MAX": (_F, -1),  # m/s
    "COM_WIND_MAX_ACT": (_I, 0),
    "EKF2_EV_CTRL": (_I, 0),
    "EKF2_GPS_CTRL": (_I, 7),
    "GF_ACTION": (_I, 2),  # 0: none, 1: warn, 2: hold, 3: return, 4: terminate, 5: land
    "GF_MAX_HOR_DIST": (_F, 0),  # m from home; 0 for no fence
    "GF_MAX_VER_DIST": (_F, 0),
    "MAV_SYS_ID": (_I, 1),
    "MC_PITCH_P": (_F, 6.5),
    "MC_ROLL_P": (_F, 6.5),
    "MC_YAW_P": (_F, 2.8),
    "MIS_TAKEOFF_ALT": (_F, 2.5),  # m
    "MPC_ACC_HOR": (_F, 3),
    "MPC_ACC_UP_MAX": (_F, 4),
    "MPC_LAND_ALT2": (_F, 5),
    "MPC_LAND_ALT3": (_F, 1),  # m; it has a distance sensor
    "MPC_LAND_CRWL": (_F, 0.3),
    "MPC_LAND_SPEED": (_F, 0.7),
    "MPC_MAN_Y_MAX": (_F, 150),  # deg/s
    "MPC_THR_HOVER": (_F, 0.5),
    "MPC_TILTMAX_AIR": (_F, 45),  # deg
    "MPC_TKO_RAMP_T": (_F, 3),
    "MPC_TKO_SPEED": (_F, 1.5),
    "MPC_VEL_MANUAL": (_F, 10),
    "MPC_XY_CRUISE": (_F, 5),
    "MPC_XY_P": (_F, 0.95),
    "MPC_Z_VEL_MAX_DN": (_F, 1.5),
    "MPC_Z_VEL_MAX_UP": (_F, 3),
    "MPC_Z_VEL_P_ACC": (_F, 4),
    "NAV_ACC_RAD": (_F, 2),  # m
    "NAV_DLL_ACT": (_I, 0),
    "NAV_RCL_ACT": (_I, 2),
    "RC_MAP_FLTMODE": (_I, 5),
    "RTL_CONE_ANG": (_I, 45),  # degrees; 0 for no cone
    "RTL_DESCEND_ALT": (_F, 30),  # m
    "RTL_LAND_DELAY": (_F, 0),
    "RTL_MIN_DIST": (_F, 10),  # m
    "RTL_RETURN_ALT": (_F, 30),
    "RTL_TYPE": (_I, 0),  # 0: straight home; others are not simulated
    "SYS_AUTOSTART": (_I, 4001),
    "SYS_HITL": (_I, 0),
}

_Values = Mapping[str, float]


def _source(bit: int) -> Callable[[_Values], float]:
    return lambda p: float(EXTERNAL if int(p["EKF2_EV_CTRL"]) & bit else GPS)


def _times(name: str, factor: float) -> Callable[[_Values], float]:
    return lambda p: p[name] * factor


def _always(value: float) -> Callable[[_Values], float]:
    return lambda _: value


DERIVED: dict[str, Callable[[_Values], float]] = {
    **{name: _always(float(default)) for name, (_, default) in ARDUPILOT.items()},
    "ACRO_YAW_RATE": _times("MPC_MAN_Y_MAX", 1),
    "ANGLE_MAX": _times("MPC_TILTMAX_AIR", 100),
    "ATC_ANGLE_BOOST": _always(0.0),
    "ATC_ANG_PIT_P": _times("MC_PITCH_P", 1),
    "ATC_ANG_RLL_P": _times("MC_ROLL_P", 1),
    "ATC_ANG_YAW_P": _times("MC_YAW_P", 1),
    "BATT_CAPACITY": lambda p: p["BAT1_CAPACITY"] if p["BAT1_CAPACITY"] > 0 else _FULL_MAH,
    "BATT_LOW_VOLT": _always(0.0),
    "EK3_SRC1_POSXY": _source(EV_HORIZONTAL),
    "EK3_SRC1_POSZ": _source(EV_VERTICAL),
    "EK3_SRC1_VELXY": _source(EV_VELOCITY),
    "EK3_SRC1_VELZ": _source(EV_VELOCITY),
    "EK3_SRC1_YAW": _source(EV_YAW),
    "VISO_TYPE": lambda p: float(p["EKF2_EV_CTRL"] != 0),
    "GPS1_TYPE": lambda p: float(p["EKF2_GPS_CTRL"] != 0),
    "FLTMODE_CH": _times("RC_MAP_FLTMODE", 1),
    **{f"FLTMODE{place}": _times(f"COM_FLTMODE{place}", 1) for place in range(1, 7)},
    "GUID_OPTIONS": _always(8.0),
    "GUID_TIMEOUT": _always(_NO_TIMEOUT_S),
    "LAND_ALT_LOW": _times("MPC_LAND_ALT2", 100),
    "LAND_SPEED": _times("MPC_LAND_SPEED", 100),
    "LAND_SPEED_HIGH": _times("MPC_Z_VEL_MAX_DN", 100),
    "LOIT_SPEED": _times("MPC_VEL_MANUAL", 100),
    "MOT_SPOOL_TIME": _times("COM_SPOOLUP_TIME", 0.5),
    "MOT_THST_HOVER": _times("MPC_THR_HOVER", 1),
    "PILOT_SPEED_DN": _times("MPC_Z_VEL_MAX_DN", 100),
    "PILOT_SPEED_UP": _times("MPC_Z_VEL_MAX_UP", 100),
    "PSC_POSXY_P": _times("MPC_XY_P", 1),
    "RTL_ALT": _times("RTL_RETURN_ALT", 100),
    "RTL_CLIMB_MIN": _always(0.0),
    "RTL_CONE_SLOPE": _always(0.0),
    "RTL_LOIT_TIME": lambda p: 1000 * max(p["RTL_LAND_DELAY"], 0.0),
    "MAV_SYSID": _times("MAV_SYS_ID", 1),
    "TKOFF_SLEW_TIME": _times("MPC_TKO_RAMP_T", 1),
    "WPNAV_ACCEL": _times("MPC_ACC_HOR", 100),
    "WPNAV_ACCEL_Z": _times("MPC_ACC_UP_MAX", 100),
    "WPNAV_SPEED": _times("MPC_XY_CRUISE", 100),
    "WPNAV_SPEED_DN": _times("MPC_Z_VEL_MAX_DN", 100),
    "WPNAV_SPEED_UP": _times("MPC_TKO_SPEED", 100),
}
