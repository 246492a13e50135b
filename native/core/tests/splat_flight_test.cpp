// The closed loop on several threads, and filters that misbehave.
#include "alula/flight/splat_flight.hpp"

#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "alula/filters/cone_di.hpp"
#include "check.hpp"

namespace {

using namespace alula;
using namespace alula::flight;

const Quadrotor kBody(0.461, {6.5e-4, 6.9e-4, 1.1e-3},
                      {.x = {0.078, -0.078, 0.078, -0.078},
                       .y = {0.078, -0.078, -0.078, 0.078},
                       .spin = {-1, -1, 1, 1},
                       .torque_ratio = 0.0116,
                       .f_min = {0, 0, 0, 0},
                       .f_max = {4.25, 4.25, 4.25, 4.25}});

// Rest to rest along x in two seconds, at y: 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, times two metres.
ReferenceCurve reference(double y) {
  std::vector<double> coefficient(32, 0.0);
  const double term[] = {35, -84, 70, -20};
  for (std::size_t j = 0; j < 4; ++j) coefficient[4 + j] = 2 * term[j] / std::pow(2.0, 4.0 + static_cast<double>(j));
  coefficient[8] = y;
  coefficient[16] = 1;
  return ReferenceCurve(std::vector<double>{0, 2}, coefficient);
}

bool same(const SplatFlightLog& a, const SplatFlightLog& b) {
  return a.state == b.state && a.position == b.position && a.u == b.u && a.status == b.status &&
         a.margin == b.margin && a.outcome == b.outcome;
}

class Wrong final : public SafetyFilter {
 public:
  explicit Wrong(double thrust) : thrust_(thrust) {}
  CommandKind kind() const override { return CommandKind::wrench; }
  FilterReport filter(const FlightState&, const Nominal& nominal) override {
    FilterReport report;
    report.status = SafetyStatus::filtered;
    report.wrench = {thrust_, nominal.wrench.torque};
    return report;
  }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<Wrong>(*this); }

 private:
  double thrust_;
};

}  // namespace

int main() {
  Control control;
  const std::vector<float> mean{1, 0.05F, 1, 1, 1, 1.1F}, scale{0.2F, 0.2F, 0.2F, 0.1F, 0.3F, 0.2F},
      quat{1, 0, 0, 0, 1, 0, 0, 0};
  const auto index = std::make_shared<const EllipsoidIndex>(Splats{mean, scale, quat, {}}, 1.0, 0.1);
  const ConeDi cone(index, ConeDiOptions{});
  const FlightVehicle vehicle{.body = kBody};
  std::vector<ReferenceCurve> references;
  for (int i = 0; i < 6; ++i) references.push_back(reference(0.2 * i));

  const auto one = fly(vehicle, {}, references, &cone, nullptr, 0, 0, 1, control);
  const auto many = fly(vehicle, {}, references, &cone, nullptr, 0, 0, 4, control);
  for (std::size_t i = 0; i < one.size(); ++i) {
    CHECK(same(one[i], many[i]));
    CHECK(one[i].position.size() == 3 * (10 * one[i].ticks() + 1));
  }
  CHECK(one[5].outcome == Outcome::reached);

  const auto plain = fly(vehicle, {}, references, nullptr, nullptr, 0, 0, 2, control);
  CHECK(plain[0].outcome == Outcome::reached);
  CHECK(least_gamma(*index, plain[0].position) < 0);  // straight through the first ellipsoid
  CHECK(!same(plain[0], one[0]));

  // A command that is not finite hovers; a command far beyond the rotors' limits is clipped and finally leaves the
  // box.
  FlightRules rules;
  rules.max_time_s = 0.5;
  const Wrong nan(std::numeric_limits<double>::quiet_NaN());
  const auto odd = fly(vehicle, rules, references, &nan, nullptr, 0, 0, 2, control);
  CHECK(odd[0].outcome == Outcome::timeout);
  CHECK(std::isfinite(odd[0].state.back()));
  rules.upper = {9, 9, 2};
  const Wrong full(1e6);
  const auto up = fly(vehicle, rules, references, &full, nullptr, 0, 0, 2, control);
  CHECK(up[0].outcome == Outcome::refused);
  CHECK(up[0].state[up[0].state.size() - 10] > 2);

  // A double integrator has no wrench; the error reaches the caller from a thread.
  FlightVehicle point = vehicle;
  point.kind = PlantKind::double_integrator;
  bool refused = false;
  try {
    fly(point, {}, references, &full, nullptr, 0, 0, 2, control);
  } catch (const std::invalid_argument&) {
    refused = true;
  }
  CHECK(refused);
  const auto exact = fly(point, {}, references, &cone, nullptr, 0, 0, 2, control);
  for (double error : exact[0].a_error) CHECK(error == 0);
  return alula_failures != 0;
}
