"""Parameters with ArduPilot's names and defaults, as far as the simulated vehicle or its clients use them."""

from __future__ import annotations

from alula.stages.sim_vehicle.common.parameters import ParamType

_B, _H, _I, _F = ParamType.INT8, ParamType.INT16, ParamType.INT32, ParamType.FLOAT

_RATE_GAINS = {"P": 0.135, "I": 0.135, "D": 0.0036, "IMAX": 0.5, "FLTT": 20.0, "FLTE": 0.0, "FLTD": 20.0}
_YAW_GAINS = {"P": 0.3, "I": 0.02, "D": 0.0, "FLTE": 2.5}

# name: (type, default). Some are here only because clients read them when they connect.
TABLE: dict[str, tuple[ParamType, float]] = {
    "ACRO_YAW_RATE": (_F, 202.5),
    "AHRS_EKF_TYPE": (_B, 3),
    "AHRS_ORIENTATION": (_B, 0),
    "ANGLE_MAX": (_H, 3000),  # centidegrees
    "ARMING_CHECK": (_I, 1),
    "ATC_ACCEL_P_MAX": (_F, 110000),
    "ATC_ACCEL_R_MAX": (_F, 110000),
    "ATC_ACCEL_Y_MAX": (_F, 27000),
    "ATC_ANGLE_BOOST": (_B, 1),
    "ATC_ANG_PIT_P": (_F, 4.5),
    "ATC_ANG_RLL_P": (_F, 4.5),
    "ATC_ANG_YAW_P": (_F, 4.5),
    "ATC_INPUT_TC": (_F, 0.15),  # s, time constant of lean-angle commands
    **{
        f"ATC_RAT_{axis}_{part}": (_F, value)
        for axis in ("PIT", "RLL")
        for part, value in _RATE_GAINS.items()
    },
    # Gains of yaw are those for ArduPilot's own simulation, P and I 1.67 and 1.11 times the firmware's.
    **{f"ATC_RAT_YAW_{part}": (_F, value) for part, value in (_RATE_GAINS | _YAW_GAINS).items()},
    "ATC_RATE_FF_ENAB": (_B, 1),
    "ATC_RATE_P_MAX": (_F, 0),  # degrees/s, of corrections of the attitude; 0 for no limit
    "ATC_RATE_R_MAX": (_F, 0),
    "ATC_RATE_Y_MAX": (_F, 0),
    "ATC_SLEW_YAW": (_F, 6000),  # centidegrees/s
    "BATT_CAPACITY": (_I, 3300),
    "BATT_CRT_MAH": (_F, 0),
    "BATT_CRT_VOLT": (_F, 0),
    "BATT_FS_CRT_ACT": (_B, 0),
    "BATT_FS_LOW_ACT": (_B, 0),
    "BATT_LOW_MAH": (_F, 0),
    "BATT_LOW_TIMER": (_B, 10),  # s
    "BATT_LOW_VOLT": (_F, 10.5),
    "BATT_MONITOR": (_B, 4),
    "BRD_TYPE": (_B, 0),
    "COMPASS_USE": (_B, 1),
    "DISARM_DELAY": (_B, 10),  # s on the ground without throttle
    "EK3_ENABLE": (_B, 1),
    "EK3_SRC1_POSXY": (_B, 3),  # 3: GPS, 6: external navigation
    "EK3_SRC1_POSZ": (_B, 1),  # 1: barometer
    "EK3_SRC1_VELXY": (_B, 3),
    "EK3_SRC1_VELZ": (_B, 3),
    "EK3_SRC1_YAW": (_B, 1),  # 1: compass
    "EK3_SRC_OPTIONS": (_H, 1),
    "FENCE_ACTION": (_B, 1),
    "FENCE_ALT_MAX": (_F, 100),
    "FENCE_ALT_MIN": (_F, -10),
    "FENCE_AUTOENABLE": (_B, 0),
    "FENCE_ENABLE": (_B, 0),
    "FENCE_MARGIN": (_F, 2),
    "FENCE_RADIUS": (_F, 300),
    "FENCE_TOTAL": (_B, 0),  # points of polygons and circles
    "FENCE_TYPE": (_B, 7),
    "FLTMODE1": (_B, 7),
    "FLTMODE2": (_B, 9),
    "FLTMODE3": (_B, 6),
    "FLTMODE4": (_B, 4),
    "FLTMODE5": (_B, 5),
    "FLTMODE6": (_B, 0),
    "FLTMODE_CH": (_B, 5),
    "FORMAT_VERSION": (_H, 120),
    "FRAME_CLASS": (_B, 1),
    "FRAME_TYPE": (_B, 1),
    "FS_CRASH_CHECK": (_B, 1),
    "FS_DR_ENABLE": (_B, 2),  # 1: land, 2: RTL
    "FS_EKF_ACTION": (_B, 1),  # 1: land
    "FS_EKF_THRESH": (_F, 0.8),
    "FS_GCS_ENABLE": (_B, 0),  # 1: RTL, 5: land
    "FS_GCS_TIMEOUT": (_F, 5),
    "FS_OPTIONS": (_I, 16),
    "FS_THR_ENABLE": (_B, 1),  # 1: RTL, 3: land
    "FS_THR_VALUE": (_H, 975),
    "FS_VIBE_ENABLE": (_B, 1),
    "GPS1_TYPE": (_B, 1),
    "GPS2_TYPE": (_B, 0),
    "GUID_OPTIONS": (_I, 0),  # 8: the "thrust" of SET_ATTITUDE_TARGET is a thrust
    "GUID_TIMEOUT": (_F, 3),
    "INITIAL_MODE": (_B, 0),
    "INS_GYRO_FILTER": (_H, 20),  # Hz
    "LAND_ALT_LOW": (_H, 1000),  # cm
    "LAND_SPEED": (_H, 50),  # cm/s below that
    "LAND_SPEED_HIGH": (_H, 0),
    "LOG_BACKEND_TYPE": (_B, 0),
    "LOIT_SPEED": (_F, 1250),
    "MAV_GCS_SYSID": (_H, 255),
    "MAV_OPTIONS": (_H, 0),
    "MAV_SYSID": (_H, 1),
    "MIS_TOTAL": (_H, 0),
    "MOT_HOVER_LEARN": (_B, 2),
    "MOT_SPIN_ARM": (_F, 0.1),
    "MOT_SPIN_MAX": (_F, 0.95),
    "MOT_SPIN_MIN": (_F, 0.15),
    "MOT_SPOOL_TIME": (_F, 0.5),
    "MOT_THST_EXPO": (_F, 0.65),
    "MOT_THST_HOVER": (_F, 0.35),
    "PILOT_SPEED_DN": (_H, 0),
    "PILOT_SPEED_UP": (_H, 250),  # cm/s
    "PILOT_TKOFF_ALT": (_F, 0),
    "PSC_ACCZ_FLTE": (_F, 20),
    "PSC_ACCZ_I": (_F, 1),
    "PSC_ACCZ_IMAX": (_F, 800),
    "PSC_ACCZ_P": (_F, 0.5),
    "PSC_ANGLE_MAX": (_F, 0),  # degrees; 0 for ANGLE_MAX
    "PSC_JERK_XY": (_F, 5),  # m/s^3
    "PSC_JERK_Z": (_F, 5),
    "PSC_POSXY_P": (_F, 1),
    "PSC_POSZ_P": (_F, 1),
    "PSC_VELXY_D": (_F, 0.25),
    "PSC_VELXY_FLTD": (_F, 5),
    "PSC_VELXY_FLTE": (_F, 5),
    "PSC_VELXY_I": (_F, 1),
    "PSC_VELXY_IMAX": (_F, 1000),
    "PSC_VELXY_P": (_F, 2),
    "PSC_VELZ_D": (_F, 0),
    "PSC_VELZ_FLTD": (_F, 5),
    "PSC_VELZ_FLTE": (_F, 5),
    "PSC_VELZ_I": (_F, 0),
    "PSC_VELZ_IMAX": (_F, 1000),
    "PSC_VELZ_P": (_F, 5),
    "RALLY_INCL_HOME": (_B, 1),
    "RALLY_LIMIT_KM": (_F, 0.3),
    "RALLY_TOTAL": (_B, 0),
    "RCMAP_PITCH": (_B, 2),
    "RCMAP_ROLL": (_B, 1),
    "RCMAP_THROTTLE": (_B, 3),
    "RCMAP_YAW": (_B, 4),
    "RC_OVERRIDE_TIME": (_F, 3),
    "RTL_ALT": (_I, 1500),  # cm
    "RTL_ALT_FINAL": (_H, 0),
    "RTL_ALT_TYPE": (_B, 0),  # 1: above the terrain
    "RTL_CLIMB_MIN": (_H, 0),  # cm
    "RTL_CONE_SLOPE": (_F, 3),  # height over distance
    "RTL_LOIT_TIME": (_I, 5000),  # ms
    "SERIAL0_PROTOCOL": (_B, 2),
    "SERIAL1_PROTOCOL": (_B, 2),
    **{
        f"SR0_{group}": (_H, 0.0)
        for group in ("EXTRA1", "EXTRA2", "EXTRA3", "EXT_STAT", "PARAMS", "POSITION", "RAW_SENS", "RC_CHAN")
    },
    "STAT_BOOTCNT": (_H, 1),
    "TELEM_DELAY": (_B, 0),
    "TKOFF_SLEW_TIME": (_F, 2),  # s from no throttle to full
    "VISO_TYPE": (_B, 0),
    "WPNAV_ACCEL": (_F, 250),  # cm/s^2
    "WPNAV_ACCEL_Z": (_F, 100),
    "WPNAV_SPEED": (_F, 1000),  # cm/s
    "WPNAV_SPEED_DN": (_F, 150),
    "WPNAV_SPEED_UP": (_F, 250),
}
