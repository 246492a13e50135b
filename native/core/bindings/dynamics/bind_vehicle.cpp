// Bindings of alula/dynamics/attitude.hpp, alula/dynamics/quadrotor.hpp, alula/dynamics/plant.hpp and
// alula/dynamics/state_predictor.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include "alula/dynamics/plant.hpp"
#include "alula/dynamics/state_predictor.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

namespace flight {
namespace {

// Parameters of a Quadrotor.
struct QuadrotorArguments {
  double mass = 0;
  Vec3 inertia;
  RotorLayout rotors;
  double gravity = 9.81;
};

}  // namespace
}  // namespace flight

template <>
struct Fields<flight::RotorLayout> {
  using Rotors = flight::RotorLayout;
  static constexpr std::tuple all{
      Field{"rotor_x", &Rotors::x, "positions along body x [m]", Limits{}, true},
      Field{"rotor_y", &Rotors::y, "positions along body y [m]", Limits{}, true},
      Field{"spin", &Rotors::spin, "sense of rotation, -1 or 1", Limits{}, true},
      Field{"torque_ratio", &Rotors::torque_ratio, "drag torque per thrust [m]", Limits{}, true},
      Field{"f_min", &Rotors::f_min, "minimum thrust of each rotor [N]", Limits{}, true},
      Field{"f_max", &Rotors::f_max, "maximum thrust of each rotor [N]", Limits{}, true}};
};

template <>
struct Fields<flight::QuadrotorArguments> {
  using Body = flight::QuadrotorArguments;
  static constexpr std::tuple all{
      Field{"mass", &Body::mass, "mass [kg]", Limits{}, true},
      Field{"inertia", &Body::inertia, "diagonal of the inertia [kg m^2]", Limits{}, true}, Nested{&Body::rotors},
      Field{"gravity", &Body::gravity, "gravity [m/s^2]"}};
};

template <>
struct Fields<flight::SensorOptions> {
  using Sensor = flight::SensorOptions;
  static constexpr std::tuple all{
      Field{"position_noise_m", &Sensor::position_noise_m, "standard deviation per axis [m]"},
      Field{"velocity_noise_m_s", &Sensor::velocity_noise_m_s, "standard deviation per axis [m/s]"},
      Field{"attitude_noise_rad", &Sensor::attitude_noise_rad, "standard deviation per axis [rad]"},
      Field{"rate_noise_rad_s", &Sensor::rate_noise_rad_s, "standard deviation per axis [rad/s]"},
      Field{"noise_time_s", &Sensor::noise_time_s, "correlation time of position and velocity; 0: white [s]"},
      Field{"delay_s", &Sensor::delay_s, "age of a measurement [s]"}};
};

template <>
struct Fields<flight::PlantOptions> {
  using Plant = flight::PlantOptions;
  static constexpr std::tuple all{
      Field{"motor_time_constant_s", &Plant::motor_time_constant_s, "lag of the rotors; 0: none [s]"},
      Field{"linear_drag", &Plant::linear_drag, "linear drag along the body axes [N s/m]"},
      Field{"quadratic_drag", &Plant::quadratic_drag, "quadratic drag along the body axes [N s^2/m^2]"},
      Field{"wind_m_s", &Plant::wind_m_s, "mean wind [m/s]"},
      Field{"gust_m_s", &Plant::gust_m_s, "standard deviation of gusts per axis [m/s]"},
      Field{"gust_time_s", &Plant::gust_time_s, "time constant of gusts [s]"},
      Field{"sensor", &Plant::sensor, "noise and delay of measurements"}};
};

template <>
struct Fields<flight::ActuatorModel> {
  using Model = flight::ActuatorModel;
  static constexpr std::tuple all{
      Field{"motor_time_constant_s", &Model::motor_time_constant_s, "assumed lag of the rotors; 0: none [s]"},
      Field{"delay_s", &Model::delay_s, "assumed age of a measurement [s]"},
      Field{"rate_time_constant_s", &Model::rate_time_constant_s,
            "of each axis of the rate loop, when commanded by body rates; 0 for all: commanded by wrenches [s]"}};
};

namespace flight {
namespace {

// f(row) for each row of one array, or of two.
template <class In, class F>
Doubles for_rows(const In& in, std::initializer_list<std::size_t> shape, F&& f) {
  Rows rows(in.shape(0));
  {
    const nb::gil_scoped_release release;
    for (std::size_t i = 0; i < in.shape(0); ++i) rows.add(f(in.data() + i * in.shape(1)));
  }
  return rows.array(shape);
}

template <class A, class B, class F>
Doubles for_rows(const A& a, const B& b, std::initializer_list<std::size_t> shape, F&& f) {
  require_rows(b.shape(0), a.shape(0));
  Rows rows(a.shape(0));
  {
    const nb::gil_scoped_release release;
    for (std::size_t i = 0; i < a.shape(0); ++i) rows.add(f(a.data() + i * a.shape(1), b.data() + i * b.shape(1)));
  }
  return rows.array(shape);
}

Vec4 rotors_at(const double* row) { return {row[0], row[1], row[2], row[3]}; }
Wrench as_row(const Vec4& f) { return {f[0], {f[1], f[2], f[3]}}; }
Doubles to_array(const Mat4& m) {
  Rows rows(1);
  for (const Vec4& row : m) rows.add(as_row(row));
  return rows.array({4, 4});
}
Triple triple(Vec3 v) { return triple_of(v); }

void bind_attitude(nb::module_& m) {
  m.def(
      "rotation_of",
      [](const InRows3<double>& sigma) {
        return for_rows(sigma, {sigma.shape(0), 3, 3},
                        [](const double* s) { return body_from_inertial(geometry::from_rows(s)); });
      },
      "sigma"_a, "R (N, 3, 3), from inertial to body components, of Modified Rodrigues Parameters (N, 3).");
  m.def(
      "rate_matrix",
      [](const InRows3<double>& sigma) {
        return for_rows(sigma, {sigma.shape(0), 3, 3},
                        [](const double* s) { return rate_matrix(geometry::from_rows(s)); });
      },
      "sigma"_a, "Z (N, 3, 3) of sigma' = Z omega.");
  m.def(
      "inverse_rate_matrix",
      [](const InRows3<double>& sigma) {
        return for_rows(sigma, {sigma.shape(0), 3, 3},
                        [](const double* s) { return inverse_rate_matrix(geometry::from_rows(s)); });
      },
      "sigma"_a, "The inverse of Z (N, 3, 3).");
  m.def(
      "rate_jacobian",
      [](const InRows3<double>& sigma, const InRows3<double>& omega) {
        return for_rows(sigma, omega, {sigma.shape(0), 3, 3}, [](const double* s, const double* w) {
          return rate_jacobian(geometry::from_rows(s), geometry::from_rows(w));
        });
      },
      "sigma"_a, "omega"_a, "The derivative of Z omega by sigma (N, 3, 3).");
  m.def(
      "shadowed",
      [](const InRows3<double>& sigma) {
        return for_rows(sigma, {sigma.shape(0), 3}, [](const double* s) { return shadowed(geometry::from_rows(s)); });
      },
      "sigma"_a, "The same attitudes with |sigma| <= 1.");
  m.def(
      "turned",
      [](const InRows3<double>& sigma, const InRows3<double>& turn) {
        return for_rows(sigma, turn, {sigma.shape(0), 3}, [](const double* s, const double* t) {
          return turned(geometry::from_rows(s), geometry::from_rows(t));
        });
      },
      "sigma"_a, "turn"_a, "The attitudes after turns by rotation vectors (N, 3) about the body's axes [rad].");
}

void bind_quadrotor(nb::module_& m) {
  nb::class_<Quadrotor>(m, "Quadrotor",
                        "A rigid body with four rotors that push along body z.\n\n"
                        "States are rows (p, sigma, v, omega) of 12, wrenches rows (T, tau) of 4 [N, N m]; see "
                        "native/core/include/alula/dynamics/quadrotor.hpp for frames and equations.")
      .def(
          "__init__",
          [](Quadrotor* self, const nb::kwargs& given) {
            QuadrotorArguments of;
            fields::assign(of, given, "Quadrotor");
            new (self) Quadrotor(of.mass, of.inertia, of.rotors, of.gravity);
          },
          nb::sig(fields::signature(QuadrotorArguments{}).c_str()),
          fields::documentation(QuadrotorArguments{}).c_str())
      .def_prop_ro("mass", &Quadrotor::mass)
      .def_prop_ro("gravity", &Quadrotor::gravity)
      .def_prop_ro("inertia", [](const Quadrotor& self) { return triple(self.inertia()); })
      .def_prop_ro("f_min", [](const Quadrotor& self) { return self.rotors().f_min; })
      .def_prop_ro("f_max", [](const Quadrotor& self) { return self.rotors().f_max; })
      .def_prop_ro("hover_thrust", &Quadrotor::hover_thrust)
      .def_prop_ro("max_thrust", &Quadrotor::max_thrust)
      .def_prop_ro(
          "allocation", [](const Quadrotor& self) { return to_array(self.allocation()); }, nb::rv_policy::move)
      .def_prop_ro(
          "inverse_allocation", [](const Quadrotor& self) { return to_array(self.inverse_allocation()); },
          nb::rv_policy::move)
      .def(
          "wrench",
          [](const Quadrotor& self, const InRows4<double>& rotors) {
            return for_rows(rotors, {rotors.shape(0), 4}, [&](const double* f) { return self.wrench(rotors_at(f)); });
          },
          "rotor_thrust"_a, "G f of rotor thrusts (N, 4).")
      .def(
          "rotor_thrust",
          [](const Quadrotor& self, const InWrenches& u) {
            return for_rows(u, {u.shape(0), 4},
                            [&](const double* row) { return as_row(self.rotor_thrust(wrench_at(row))); });
          },
          "u"_a, "Rotor thrusts (N, 4) of wrenches (N, 4).")
      .def(
          "admissible",
          [](const Quadrotor& self, const InWrenches& u, double tolerance) {
            std::vector<std::uint8_t> result(u.shape(0));
            for (std::size_t i = 0; i < result.size(); ++i)
              result[i] = self.admissible(wrench_at(u.data() + 4 * i), tolerance) ? 1 : 0;
            return to_numpy(std::move(result), {u.shape(0)});
          },
          "u"_a, nb::kw_only(), "tolerance_n"_a = 0.0, "1 where all rotors are within their limits.")
      .def(
          "limited",
          [](const Quadrotor& self, const InWrenches& u) {
            return for_rows(u, {u.shape(0), 4}, [&](const double* row) { return self.limited(wrench_at(row)); });
          },
          "u"_a, "Admissible wrenches: roll and pitch in preference to yaw, torque in preference to thrust.")
      .def(
          "saturated",
          [](const Quadrotor& self, const InWrenches& u) {
            return for_rows(u, {u.shape(0), 4}, [&](const double* row) { return self.saturated(wrench_at(row)); });
          },
          "u"_a, "Wrenches after each rotor thrust is clipped to its limits.")
      .def(
          "derivative",
          [](const Quadrotor& self, const InStates& x, const InWrenches& u) {
            return for_rows(x, u, {x.shape(0), 12}, [&](const double* state, const double* row) {
              return self.derivative(state_at(state), wrench_at(row));
            });
          },
          "x"_a, "u"_a, "x' (N, 12).")
      .def(
          "step",
          [](const Quadrotor& self, const InStates& x, const InWrenches& u, double dt_s) {
            return for_rows(x, u, {x.shape(0), 12}, [&](const double* state, const double* row) {
              return self.step(state_at(state), wrench_at(row), dt_s);
            });
          },
          "x"_a, "u"_a, nb::kw_only(), "dt_s"_a, "States after one RK4 step with the wrenches held.");
}

void bind_plants(nb::module_& m) {
  fields::bind<SensorOptions>(m, "SensorOptions",
                              "Noise (standard deviations per axis) and delay; all off by default.");
  fields::bind<PlantOptions>(m, "PlantOptions", "Disturbances of a quadrotor in flight; all off by default.");

  nb::class_<Plant>(m, "Plant",
                    "A quadrotor in flight: alula/dynamics/plant.hpp. Off options make steps those of Quadrotor.")
      .def(
          "__init__",
          [](Plant* self, const Quadrotor& quadrotor, const PlantOptions& options, std::uint64_t seed,
             std::uint32_t trial) { new (self) Plant(quadrotor, options, {seed, trial}); },
          "quadrotor"_a, "options"_a = PlantOptions{}, nb::kw_only(), "seed"_a = 0, "trial"_a = 0)
      .def(
          "reset", [](Plant& self, const InState& x) { self.reset(state_at(x.data())); }, "x"_a)
      .def(
          "step",
          [](Plant& self, double dt, const In<double, nb::shape<4>>& u) { self.step(dt, wrench_at(u.data())); },
          "dt_s"_a, "command"_a)
      .def(
          "fly",
          [](Plant& self, double dt, const InWrenches& u) {
            Rows rows(u.shape(0));
            for (std::size_t i = 0; i < u.shape(0); ++i) {
              self.step(dt, wrench_at(u.data() + 4 * i));
              rows.add(self.state());
            }
            return rows.array({u.shape(0), 12});
          },
          "dt_s"_a, "command"_a, "The states after steps with commands (N, 4), shape (N, 12).")
      .def("switch_shadow", &Plant::switch_shadow)
      .def_prop_ro(
          "state", [](const Plant& self) { return flight::to_array(self.state()); }, nb::rv_policy::move)
      .def_prop_ro(
          "measured", [](const Plant& self) { return flight::to_array(self.measured()); }, nb::rv_policy::move)
      .def_prop_ro(
          "wrench", [](const Plant& self) { return flight::to_array(self.wrench()); }, nb::rv_policy::move)
      .def_prop_ro("thrust", &Plant::thrust)
      .def_prop_ro("acceleration", [](const Plant& self) { return triple(self.acceleration()); })
      .def_prop_ro("wind", [](const Plant& self) { return triple(self.wind()); })
      .def_prop_ro("time_s", &Plant::time)
      .def_prop_ro("steps", &Plant::steps);

  nb::class_<DoubleIntegrator>(m, "DoubleIntegrator", "p' = v, v' = a with a held, stepped exactly.")
      .def(
          "__init__",
          [](DoubleIntegrator* self, double most, const SensorOptions& sensor, std::uint64_t seed,
             std::uint32_t trial) { new (self) DoubleIntegrator(most, sensor, {seed, trial}); },
          nb::kw_only(), "max_acceleration_m_s2"_a = std::numeric_limits<double>::infinity(),
          "sensor"_a = SensorOptions{}, "seed"_a = 0, "trial"_a = 0)
      .def(
          "reset", [](DoubleIntegrator& self, const InState& x) { self.reset(state_at(x.data())); }, "x"_a)
      .def(
          "step", [](DoubleIntegrator& self, double dt, const Triple& a) { self.step(dt, vector_of(a)); }, "dt_s"_a,
          "acceleration"_a)
      .def_prop_ro(
          "state", [](const DoubleIntegrator& self) { return flight::to_array(self.state()); }, nb::rv_policy::move)
      .def_prop_ro(
          "measured", [](const DoubleIntegrator& self) { return flight::to_array(self.measured()); },
          nb::rv_policy::move)
      .def_prop_ro("acceleration", [](const DoubleIntegrator& self) { return triple(self.acceleration()); })
      .def_prop_ro("time_s", &DoubleIntegrator::time)
      .def_prop_ro("steps", &DoubleIntegrator::steps);
}

void bind_predictor(nb::module_& m) {
  fields::bind<ActuatorModel>(m, "ActuatorModel",
                              "Rotor lag and measurement age assumed by the controller and filters.");
  nb::class_<StatePredictor>(
      m, "StatePredictor",
      "Predicts the present state from an older measurement, by the model: alula/dynamics/state_predictor.hpp.")
      .def(nb::init<const Quadrotor&, const ActuatorModel&, double>(), "body"_a, "model"_a, nb::kw_only(), "tick_s"_a)
      .def("reset", &StatePredictor::reset, "Reset to a history of hovering.")
      .def(
          "now",
          [](const StatePredictor& self, const InState& measured, std::optional<double> age_s) {
            return flight::to_array(self.now(state_at(measured.data()), age_s.value_or(self.model().delay_s)));
          },
          "measured"_a, "age_s"_a = nb::none(),
          "Predict the present state (12,) from the state age_s ago; age_s is at most the model's delay, the "
          "default.")
      .def(
          "fly",
          [](StatePredictor& self, const In<double, nb::shape<4>>& u, const Triple& rates,
             const std::optional<InState>& now) {
            if (!now && flight::has_rate_loop(self.model().rate_time_constant_s))
              throw std::invalid_argument("a rate loop needs the rates and the present state");
            self.fly(wrench_at(u.data()), vector_of(rates), now ? state_at(now->data()) : State{});
          },
          "wrench"_a, "rates"_a = Triple{}, "now"_a = nb::none(),
          "Record a wrench that is commanded from now on for a tick [N, N m]; with a rate loop its thrust, the body "
          "rates [rad/s], and the predicted present state (12,).")
      .def(
          "lead",
          [](const StatePredictor& self, const In<double, nb::shape<4>>& u) {
            return flight::to_array(self.lead(wrench_at(u.data())));
          },
          "wrench"_a, "Command with which the rotors reach a wrench by the end of a tick that begins now [N, N m].")
      .def_prop_ro("rotors", &StatePredictor::rotors, "Thrust of each rotor now [N].");
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_vehicle(nb::module_& m) {
  alula::flight::bind_attitude(m);
  alula::flight::bind_quadrotor(m);
  alula::flight::bind_plants(m);
  alula::flight::bind_predictor(m);
}
