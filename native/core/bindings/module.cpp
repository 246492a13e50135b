// The extension module alula._core: one bind_* function per header of native/core.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_voxelize(nb::module_& m);
void bind_touch(nb::module_& m);
void bind_observe(nb::module_& m);
void bind_separation(nb::module_& m);
void bind_merge(nb::module_& m);
void bind_union_measure(nb::module_& m);
void bind_cover_check(nb::module_& m);
void bind_polytope_cbf(nb::module_& m);
void bind_onboard_map(nb::module_& m);
void bind_clearance(nb::module_& m);
void bind_obstacle_map(nb::module_& m);
void bind_search(nb::module_& m);
void bind_corridor(nb::module_& m);
void bind_outer_solid(nb::module_& m);
void bind_ply_rows(nb::module_& m);
void bind_scene_rows(nb::module_& m);
void bind_vehicle(nb::module_& m);
void bind_tracking(nb::module_& m);
void bind_qp(nb::module_& m);
void bind_splat_filters(nb::module_& m);
void bind_backup(nb::module_& m);
void bind_wrench_filters(nb::module_& m);
void bind_flight(nb::module_& m);
void bind_tracker(nb::module_& m);
void bind_moving_world(nb::module_& m);
void bind_moving_filters(nb::module_& m);
void bind_racer(nb::module_& m);
void bind_geofence(nb::module_& m);
void bind_onboard_stack(nb::module_& m);
void bind_pendulum(nb::module_& m);
void bind_rates(nb::module_& m);
void bind_picture(nb::module_& m);

NB_MODULE(_core, m) {
  m.doc() = "Hot loops of alula, in C++20 and C99.";
  m.def("commit", [] { return ALULA_COMMIT; }, "The commit that a wheel was built from; empty in an editable build.");
  bind_voxelize(m);
  bind_touch(m);
  bind_observe(m);
  bind_separation(m);
  bind_merge(m);
  bind_union_measure(m);
  bind_cover_check(m);
  bind_polytope_cbf(m);
  bind_onboard_map(m);
  bind_clearance(m);
  bind_search(m);
  bind_corridor(m);
  bind_outer_solid(m);
  bind_ply_rows(m);
  bind_scene_rows(m);
  bind_vehicle(m);
  bind_tracking(m);
  bind_qp(m);
  bind_splat_filters(m);
  bind_backup(m);
  bind_obstacle_map(m);
  bind_wrench_filters(m);
  bind_tracker(m);
  bind_moving_world(m);
  bind_moving_filters(m);
  bind_racer(m);
  bind_geofence(m);
  bind_onboard_stack(m);
  bind_pendulum(m);
  bind_rates(m);
  bind_picture(m);
  bind_flight(m);
}
