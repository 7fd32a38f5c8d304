# SPDX-License-Identifier: Apache-2.0
"""clba.h in ctypes: its structs, its functions, and what turns a status into an exception."""

from __future__ import annotations

import ctypes
import operator
import re
from ctypes import (
    POINTER,
    Structure,
    c_char,
    c_char_p,
    c_double,
    c_int32,
    c_int64,
    c_size_t,
    c_uint8,
    c_uint32,
    c_uint64,
    c_void_p,
)
from typing import Any, TypeVar

from clba import _library
from clba._errors import BY_STATUS, Error


class ContextHandle(Structure):
    """clba_context"""


class ProblemHandle(Structure):
    """clba_problem"""


class ResultHandle(Structure):
    """clba_result"""


class CovarianceHandle(Structure):
    """clba_covariance"""


class CancellationHandle(Structure):
    """clba_cancellation"""


class DeviceInfo(Structure):
    """clba_device_info"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("index", c_int32),
        ("type", c_int32),
        ("has_double", c_int32),
        ("compute_units", c_int32),
        ("has_unified_memory", c_int32),
        ("global_memory_bytes", c_uint64),
        ("max_allocation_bytes", c_uint64),
        ("local_memory_bytes", c_uint64),
        ("platform", c_char * 128),
        ("name", c_char * 128),
        ("vendor", c_char * 128),
        ("version", c_char * 128),
        ("driver", c_char * 128),
    ]


class ContextOptions(Structure):
    """clba_context_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("device_index", c_int32),
        ("device", c_char_p),
        ("cache_dir", c_char_p),
        ("max_allocation_bytes", c_uint64),
        ("cl_context", c_void_p),
        ("cl_device_id", c_void_p),
        ("cl_command_queue", c_void_p),
    ]


class ProblemInfo(Structure):
    """clba_problem_info"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("num_cameras", c_int32),
        ("num_images", c_int32),
        ("num_points", c_int32),
        ("num_observations", c_int64),
        ("num_parameters", c_int64),
        ("num_image_camera_parameters", c_int64),
        ("num_parameters_per_image_block", c_int32),
        ("num_shared_cameras", c_int32),
        ("num_frames", c_int32),
        ("num_sensors", c_int32),
    ]


class Rigs(Structure):
    """clba_rigs"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("num_frames", c_int32),
        ("num_sensors", c_int32),
        ("reserved", c_int32),
        ("frames", POINTER(c_int32)),
        ("sensors", POINTER(c_int32)),
        ("sensor_poses", POINTER(c_double)),
        ("frame_poses", POINTER(c_double)),
        ("constant_sensors", POINTER(c_int32)),
        ("constant_frames", POINTER(c_int32)),
    ]


class Iteration(Structure):
    """clba_iteration"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("iteration", c_int32),
        ("step_is_accepted", c_int32),
        ("step_is_valid", c_int32),
        ("linear_solver_iterations", c_int32),
        ("remaining_iterations", c_int32),
        ("num_behind", c_int64),
        ("cost", c_double),
        ("cost_change", c_double),
        ("gradient_max_norm", c_double),
        ("step_norm", c_double),
        ("gain_ratio", c_double),
        ("trust_region_radius", c_double),
        ("seconds", c_double),
        ("remaining_seconds", c_double),
    ]


IterationFunction = ctypes.CFUNCTYPE(c_int32, POINTER(Iteration), c_void_p)


class SolverOptions(Structure):
    """clba_solver_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("linear_solver", c_int32),
        ("preconditioner", c_int32),
        ("damping", c_int32),
        ("precision", c_int32),
        ("max_num_iterations", c_int32),
        ("max_linear_solver_iterations", c_int32),
        ("min_linear_solver_iterations", c_int32),
        ("max_num_consecutive_invalid_steps", c_int32),
        ("jacobian", c_int32),
        ("initial_trust_region_radius", c_double),
        ("max_trust_region_radius", c_double),
        ("min_trust_region_radius", c_double),
        ("min_relative_decrease", c_double),
        ("min_damping_diagonal", c_double),
        ("max_damping_diagonal", c_double),
        ("function_tolerance", c_double),
        ("gradient_tolerance", c_double),
        ("parameter_tolerance", c_double),
        ("target_cost", c_double),
        ("max_seconds", c_double),
        ("eta", c_double),
        ("on_iteration", IterationFunction),
        ("user_data", c_void_p),
        ("cancellation", POINTER(CancellationHandle)),
        ("checkpoint_path", c_char_p),
        ("resume_path", c_char_p),
        ("checkpoint_every", c_int32),
        ("reserved", c_int32),
    ]


class Summary(Structure):
    """clba_summary"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("termination", c_int32),
        ("reason", c_int32),
        ("linear_solver", c_int32),
        ("preconditioner", c_int32),
        ("damping", c_int32),
        ("precision", c_int32),
        ("num_iterations", c_int32),
        ("num_accepted_steps", c_int32),
        ("num_rejected_steps", c_int32),
        ("num_invalid_steps", c_int32),
        ("num_linear_solver_iterations", c_int32),
        ("num_behind_initial", c_int64),
        ("num_behind_final", c_int64),
        ("num_singular", c_int64),
        ("num_indefinite_blocks", c_int64),
        ("eta", c_double),
        ("initial_cost", c_double),
        ("final_cost", c_double),
        ("reference_final_cost", c_double),
        ("total_seconds", c_double),
        ("build_seconds", c_double),
        ("setup_seconds", c_double),
        ("linearize_seconds", c_double),
        ("linear_solver_seconds", c_double),
        ("evaluate_seconds", c_double),
        ("reference_seconds", c_double),
        ("other_seconds", c_double),
        ("residual_device_seconds", c_double),
        ("jacobian_device_seconds", c_double),
        ("preconditioner_device_seconds", c_double),
        ("jx_device_seconds", c_double),
        ("jty_device_seconds", c_double),
        ("schur_device_seconds", c_double),
        ("vector_device_seconds", c_double),
        ("peak_device_bytes", c_uint64),
        ("device", c_char * 128),
        ("message", c_char * 256),
        ("given_linear_solver", c_int32),
        ("given_preconditioner", c_int32),
        ("given_precision", c_int32),
        ("jacobian", c_int32),
        ("factorization_seconds", c_double),
        ("host_seconds", c_double),
        ("choice", c_char * 256),
        ("resumed_iteration", c_int32),
        ("num_checkpoints", c_int32),
        ("checkpoint_error", c_char * 256),
        ("gauge", c_int32),
        ("num_gauge_freedoms", c_int32),
        ("initial_prior_cost", c_double),
        ("final_prior_cost", c_double),
    ]


class Window(Structure):
    """clba_window"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("refine_shared_cameras", c_int32),
        ("num_images", c_int32),
        ("num_points", c_int32),
        ("images", POINTER(c_int32)),
        ("points", POINTER(c_int32)),
        ("num_free_points", c_int32),
        ("num_constant_images", c_int32),
        ("num_observations", c_int64),
    ]


class Evaluation(Structure):
    """clba_evaluation"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("precision", c_int32),
        ("apply_loss", c_int32),
        ("reserved", c_int32),
        ("cost", c_double),
        ("num_behind", c_int64),
        ("num_singular", c_int64),
        ("residuals", POINTER(c_double)),
        ("gradient", POINTER(c_double)),
        ("jacobian_images", POINTER(c_double)),
        ("jacobian_points", POINTER(c_double)),
    ]


class CovarianceOptions(Structure):
    """clba_covariance_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("gauge", c_int32),
        ("gauge_images", c_int32 * 2),
        ("gauge_points", c_int32 * 3),
        ("method", c_int32),
        ("apply_variance_factor", c_int32),
        ("all_points", c_int32),
        ("points", POINTER(c_int32)),
        ("num_points", c_int64),
        ("max_bytes", c_uint64),
        ("num_samples", c_int32),
        ("max_linear_solver_iterations", c_int32),
        ("relative_error", c_double),
        ("seed", c_uint64),
    ]


class CovarianceInfo(Structure):
    """clba_covariance_info"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("gauge", c_int32),
        ("gauge_images", c_int32 * 2),
        ("gauge_points", c_int32 * 3),
        ("num_freedoms", c_int32),
        ("method", c_int32),
        ("num_samples", c_int32),
        ("variance_factor_is_applied", c_int32),
        ("num_images", c_int32),
        ("num_cameras", c_int32),
        ("reserved", c_int32),
        ("num_points", c_int64),
        ("relative_error", c_double),
        ("cost", c_double),
        ("variance_factor", c_double),
        ("redundancy", c_int64),
        ("num_undetermined_parameters", c_int64),
        ("num_undetermined_points", c_int64),
        ("num_linear_solver_iterations", c_int64),
        ("bytes", c_uint64),
        ("total_seconds", c_double),
        ("form_seconds", c_double),
        ("factor_seconds", c_double),
        ("inverse_seconds", c_double),
        ("point_seconds", c_double),
    ]


class GaugeTarget(Structure):
    """clba_gauge_target"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("gauge", c_int32),
        ("images", c_int32 * 2),
        ("points", c_int32 * 3),
        ("reserved", c_int32),
        ("pose", POINTER(c_double)),
        ("baseline", c_double),
        ("xyz", POINTER(c_double)),
        ("centers", POINTER(c_double)),
    ]


class FilterOptions(Structure):
    """clba_filter_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("error_unit", c_int32),
        ("remove_behind", c_int32),
        ("min_num_views", c_int32),
        ("max_reprojection_error", c_double),
        ("min_triangulation_angle", c_double),
        ("remove_points", c_int32),
        ("reserved", c_int32),
    ]


class FilterReport(Structure):
    """clba_filter_report"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("num_images_unobserved", c_int32),
        ("num_observations_removed", c_int64),
        ("num_behind", c_int64),
        ("num_large_error", c_int64),
        ("num_few_views", c_int64),
        ("num_small_angle", c_int64),
        ("num_points_few_views", c_int32),
        ("num_points_small_angle", c_int32),
        ("num_points_unobserved", c_int32),
        ("num_points_removed", c_int32),
        ("observation_rows", POINTER(c_int64)),
        ("point_rows", POINTER(c_int32)),
        ("unobserved_images", POINTER(c_int32)),
    ]


class Comparison(Structure):
    """clba_comparison"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("reserved", c_int32),
        ("scale", c_double),
        ("max_center_distance", c_double),
        ("median_center_distance", c_double),
        ("max_point_distance", c_double),
        ("median_point_distance", c_double),
        ("extent", c_double),
    ]


ProgressFunction = ctypes.CFUNCTYPE(c_int32, c_double, c_void_p)


class ReadOptions(Structure):
    """clba_read_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("format", c_int32),
        ("on_progress", ProgressFunction),
        ("user_data", c_void_p),
    ]


class WriteOptions(Structure):
    """clba_write_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("format", c_int32),
        ("accept_loss", c_int32),
        ("reserved", c_int32),
    ]


class SceneOptions(Structure):
    """clba_scene_options"""

    _fields_ = [
        ("struct_size", c_uint32),
        ("scene", c_int32),
        ("num_images", c_int32),
        ("num_points", c_int32),
        ("observations_per_image", c_int32),
        ("reserved", c_int32),
        ("seed", c_uint64),
        ("pixel_noise", c_double),
        ("outlier_share", c_double),
        ("rotation_noise", c_double),
        ("position_noise", c_double),
        ("point_noise", c_double),
    ]


STRUCTS: dict[str, type[Structure]] = {
    str(struct.__doc__): struct
    for struct in (
        DeviceInfo,
        ContextOptions,
        ProblemInfo,
        Rigs,
        Iteration,
        SolverOptions,
        Summary,
        Window,
        Evaluation,
        CovarianceOptions,
        CovarianceInfo,
        GaugeTarget,
        FilterOptions,
        FilterReport,
        Comparison,
        ReadOptions,
        WriteOptions,
        SceneOptions,
    )
}

_status = c_int32
_context = POINTER(ContextHandle)
_problem = POINTER(ProblemHandle)
_result = POINTER(ResultHandle)
_covariance = POINTER(CovarianceHandle)
_cancellation = POINTER(CancellationHandle)
_int32s = POINTER(c_int32)
_int64s = POINTER(c_int64)
_doubles = POINTER(c_double)
_uint64s = POINTER(c_uint64)
_bytes = POINTER(c_uint8)
_rig_poses = [_problem, c_int32, c_int32, _doubles, c_size_t, _int32s, c_size_t]
_priors = [_problem, c_int32, _int32s, c_size_t, _doubles, c_size_t, _doubles, c_size_t]

# Function: type of the result, types of the arguments.
PROTOTYPES: dict[str, tuple[Any, list[Any]]] = {
    "clba_version": (c_uint32, []),
    "clba_status_string": (c_char_p, [_status]),
    "clba_last_error": (c_char_p, []),
    "clba_num_devices": (_status, [_int32s]),
    "clba_get_device": (_status, [c_int32, POINTER(DeviceInfo)]),
    "clba_context_options_init": (_status, [POINTER(ContextOptions), c_size_t]),
    "clba_context_create": (_status, [POINTER(ContextOptions), POINTER(_context)]),
    "clba_context_retain": (_status, [_context]),
    "clba_context_release": (None, [_context]),
    "clba_context_get_device": (_status, [_context, POINTER(DeviceInfo)]),
    "clba_num_camera_models": (c_int32, []),
    "clba_camera_model_name": (c_char_p, [c_int32]),
    "clba_camera_model_num_params": (c_int32, [c_int32]),
    "clba_camera_model_param_names": (c_char_p, [c_int32]),
    "clba_problem_create": (_status, [POINTER(_problem)]),
    "clba_problem_retain": (_status, [_problem]),
    "clba_problem_release": (None, [_problem]),
    "clba_problem_get_info": (_status, [_problem, POINTER(ProblemInfo)]),
    "clba_problem_set_cameras": (
        _status,
        [_problem, c_int32, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_set_images": (
        _status,
        [_problem, c_int32, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_set_points": (_status, [_problem, c_int32, _doubles, c_size_t]),
    "clba_problem_set_observations": (
        _status,
        [_problem, c_int64, _int32s, c_size_t, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_set_covariances": (_status, [_problem, c_int64, _doubles, c_size_t]),
    "clba_problem_set_sigmas": (_status, [_problem, c_int64, _doubles, c_size_t]),
    "clba_problem_add_cameras": (
        _status,
        [_problem, c_int32, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_add_images": (
        _status,
        [_problem, c_int32, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_add_points": (_status, [_problem, c_int32, _doubles, c_size_t]),
    "clba_problem_add_observations": (
        _status,
        [
            _problem,
            c_int64,
            _int32s,
            c_size_t,
            _int32s,
            c_size_t,
            _doubles,
            c_size_t,
            _doubles,
            c_size_t,
        ],
    ),
    "clba_problem_get_cameras": (
        _status,
        [_problem, c_int32, c_int32, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_get_images": (
        _status,
        [_problem, c_int32, c_int32, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_get_centers": (_status, [_problem, c_int32, c_int32, _doubles, c_size_t]),
    "clba_problem_get_points": (_status, [_problem, c_int32, c_int32, _doubles, c_size_t]),
    "clba_problem_get_constant_images": (_status, [_problem, c_int32, c_int32, _int32s, c_size_t]),
    "clba_problem_get_constant_cameras": (_status, [_problem, c_int32, c_int32, _int32s, c_size_t]),
    "clba_problem_get_constant_points": (_status, [_problem, c_int32, c_int32, _int32s, c_size_t]),
    "clba_problem_get_observations": (
        _status,
        [_problem, c_int64, c_int64, _int32s, c_size_t, _int32s, c_size_t, _doubles, c_size_t],
    ),
    "clba_problem_set_constant_images": (_status, [_problem, c_int32, _int32s, c_size_t]),
    "clba_problem_set_constant_cameras": (_status, [_problem, c_int32, _int32s, c_size_t]),
    "clba_problem_set_constant_points": (_status, [_problem, c_int32, _int32s, c_size_t]),
    "clba_problem_set_image_uncertainties": (_status, [_problem, c_int32, _doubles, c_size_t]),
    "clba_problem_set_camera_uncertainties": (_status, [_problem, c_int32, _doubles, c_size_t]),
    "clba_problem_set_point_uncertainties": (_status, [_problem, c_int32, _doubles, c_size_t]),
    "clba_loss_name": (c_char_p, [c_int32]),
    "clba_problem_set_loss": (_status, [_problem, c_int32, c_double]),
    "clba_rigs_init": (_status, [POINTER(Rigs), c_size_t]),
    "clba_problem_set_rigs": (_status, [_problem, POINTER(Rigs)]),
    "clba_problem_get_frames": (_status, _rig_poses),
    "clba_problem_get_sensors": (_status, _rig_poses),
    "clba_problem_get_image_rigs": (
        _status,
        [_problem, c_int32, c_int32, _int32s, c_size_t, _int32s, c_size_t],
    ),
    "clba_problem_get_sensor_offsets": (_status, [_problem, _int64s]),
    "clba_problem_set_position_priors": (_status, _priors),
    "clba_problem_set_pose_priors": (_status, _priors),
    "clba_problem_set_intrinsics_priors": (_status, _priors),
    "clba_problem_set_point_priors": (_status, _priors),
    "clba_problem_set_relative_pose_priors": (_status, _priors),
    "clba_linear_solver_name": (c_char_p, [c_int32]),
    "clba_preconditioner_name": (c_char_p, [c_int32]),
    "clba_damping_name": (c_char_p, [c_int32]),
    "clba_precision_name": (c_char_p, [c_int32]),
    "clba_jacobian_name": (c_char_p, [c_int32]),
    "clba_cancellation_create": (_status, [POINTER(_cancellation)]),
    "clba_cancellation_retain": (_status, [_cancellation]),
    "clba_cancellation_release": (None, [_cancellation]),
    "clba_cancellation_request": (None, [_cancellation]),
    "clba_cancellation_reset": (None, [_cancellation]),
    "clba_cancellation_is_requested": (c_int32, [_cancellation]),
    "clba_gauge_state_name": (c_char_p, [c_int32]),
    "clba_solver_options_init": (_status, [POINTER(SolverOptions), c_size_t]),
    "clba_problem_solve": (
        _status,
        [_problem, _context, POINTER(SolverOptions), POINTER(_result)],
    ),
    "clba_window_init": (_status, [POINTER(Window), c_size_t]),
    "clba_problem_solve_window": (
        _status,
        [_problem, _context, POINTER(SolverOptions), POINTER(Window), POINTER(_result)],
    ),
    "clba_result_release": (None, [_result]),
    "clba_result_get_summary": (_status, [_result, POINTER(Summary)]),
    "clba_result_num_rows": (c_int32, [_result]),
    "clba_result_get_row": (_status, [_result, c_int32, POINTER(Iteration)]),
    "clba_result_report": (c_char_p, [_result]),
    "clba_result_json": (c_char_p, [_result]),
    "clba_problem_get_offsets": (_status, [_problem, _int64s, _int64s]),
    "clba_evaluation_init": (_status, [POINTER(Evaluation), c_size_t]),
    "clba_problem_evaluate": (_status, [_problem, _context, POINTER(Evaluation)]),
    "clba_problem_multiply": (
        _status,
        [_problem, _context, c_int32, c_int32, c_double, _doubles, _doubles],
    ),
    "clba_problem_apply_step": (_status, [_problem, _doubles]),
    "clba_covariance_gauge_name": (c_char_p, [c_int32]),
    "clba_covariance_method_name": (c_char_p, [c_int32]),
    "clba_covariance_options_init": (_status, [POINTER(CovarianceOptions), c_size_t]),
    "clba_problem_covariance": (
        _status,
        [_problem, _context, POINTER(CovarianceOptions), POINTER(_covariance)],
    ),
    "clba_covariance_release": (None, [_covariance]),
    "clba_covariance_get_info": (_status, [_covariance, POINTER(CovarianceInfo)]),
    "clba_covariance_get": (
        _status,
        [_covariance, c_int32, c_int64, c_int64, _doubles, _doubles, c_size_t],
    ),
    "clba_gauge_target_init": (_status, [POINTER(GaugeTarget), c_size_t]),
    "clba_problem_fix_gauge": (_status, [_problem, POINTER(GaugeTarget)]),
    "clba_unit_name": (c_char_p, [c_int32]),
    "clba_problem_get_reprojection_errors": (
        _status,
        [_problem, c_int32, c_int64, c_int64, _doubles, c_size_t],
    ),
    "clba_filter_options_init": (_status, [POINTER(FilterOptions), c_size_t]),
    "clba_problem_filter": (
        _status,
        [_problem, POINTER(FilterOptions), POINTER(FilterReport)],
    ),
    "clba_problem_remove_observations": (
        _status,
        [_problem, c_int64, _int32s, c_size_t, c_int32, POINTER(FilterReport)],
    ),
    "clba_problem_compare": (_status, [_problem, _problem, POINTER(Comparison)]),
    "clba_format_name": (c_char_p, [c_int32]),
    "clba_read_options_init": (_status, [POINTER(ReadOptions), c_size_t]),
    "clba_problem_read": (_status, [c_char_p, POINTER(ReadOptions), POINTER(_problem)]),
    "clba_problem_notices": (c_char_p, [_problem]),
    "clba_problem_get_format": (c_int32, [_problem]),
    "clba_write_options_init": (_status, [POINTER(WriteOptions), c_size_t]),
    "clba_problem_write": (_status, [_problem, c_char_p, POINTER(WriteOptions)]),
    "clba_problem_check_write": (_status, [_problem, c_char_p, POINTER(WriteOptions)]),
    "clba_problem_get_camera_info": (
        _status,
        [_problem, c_int32, c_int32, _uint64s, c_size_t, _uint64s, c_size_t],
    ),
    "clba_problem_get_image_ids": (_status, [_problem, c_int32, c_int32, _uint64s, c_size_t]),
    "clba_problem_get_point_info": (
        _status,
        [_problem, c_int32, c_int32, _uint64s, c_size_t, _bytes, c_size_t],
    ),
    "clba_problem_get_image_name": (c_char_p, [_problem, c_int32]),
    "clba_problem_read_bal": (_status, [c_char_p, POINTER(_problem)]),
    "clba_problem_write_bal": (_status, [_problem, c_char_p]),
    "clba_problem_write_ply": (_status, [_problem, c_char_p]),
    "clba_scene_name": (c_char_p, [c_int32]),
    "clba_scene_options_init": (_status, [POINTER(SceneOptions), c_size_t]),
    "clba_problem_generate": (
        _status,
        [POINTER(SceneOptions), POINTER(_problem), POINTER(_problem)],
    ),
}


def _declare(library: ctypes.CDLL) -> ctypes.CDLL:
    for name, (restype, argtypes) in PROTOTYPES.items():
        function = getattr(library, name)
        function.restype = restype
        function.argtypes = argtypes
    return library


lib = _declare(_library.load())

_Struct = TypeVar("_Struct", bound=Structure)


def check(status: int, **names: str) -> None:
    """Raises the exception of an error status.

    Args:
        names: what the C library's arguments are called in Python, for the message.
    """
    if status == 0:
        return
    message = lib.clba_last_error().decode(errors="replace")
    for ours, theirs in names.items():
        message = re.sub(rf"\b{ours}(?=\[| has | = )", theirs, message)
    raise BY_STATUS.get(status, Error)(message)


def sized(struct: type[_Struct]) -> _Struct:
    """An empty struct that names its size, for functions that fill it."""
    return struct(struct_size=ctypes.sizeof(struct))


def fields(struct: Structure) -> dict[str, Any]:
    """The fields of a struct as Python values, texts decoded, less those without meaning."""
    values = {}
    for name, *_ in struct._fields_:
        value = getattr(struct, name)
        values[name] = value.decode(errors="replace") if isinstance(value, bytes) else value
    values.pop("struct_size")
    values.pop("reserved", None)
    return values


def text(pointer: bytes | None) -> str:
    """A C string that is never NULL here."""
    assert pointer is not None
    return pointer.decode(errors="replace")


def number(name: str, value: Any, kind: type) -> Any:
    """value as int or float.

    Raises:
        TypeError: it is not one.
    """
    try:
        if isinstance(value, (bool, str, bytes)):
            raise TypeError
        converted = operator.index(value) if kind is int else float(value)
    except TypeError:
        wanted = "an integer" if kind is int else "a number"
        raise TypeError(f"{name} = {value!r}, but it must be {wanted}") from None
    return converted


def set_number(struct: Structure, name: str, value: Any) -> None:
    """Sets a field of a struct, unless value is None: then it keeps its default."""
    if value is None:
        return
    c_type = dict(field[:2] for field in struct._fields_)[name]
    converted = number(name, value, float if c_type is c_double else int)
    setattr(struct, name, converted)
    # ctypes cuts integers that are too large.
    if c_type is not c_double and getattr(struct, name) != converted:
        raise ValueError(f"{name} = {value}, but it must fit into {8 * ctypes.sizeof(c_type)} bits")
