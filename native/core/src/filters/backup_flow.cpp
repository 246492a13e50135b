#include "alula/filters/backup_flow.hpp"

#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::e3;
using geometry::multiply;

// out (+)= m w, for the first Count columns.
template <int Count, bool Add, class Rows>
void product(const Mat3& m, const Rows& w, Rows& out) {
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < Count; ++j) {
      const int row = static_cast<int>(i);
      const double sum = m[row][0] * w[0][j] + m[row][1] * w[1][j] + m[row][2] * w[2][j];
      out[i][j] = Add ? out[i][j] + sum : sum;
    }
}

template <int Count, class Columns>
void add_scaled(const Columns& a, double s, const Columns& b, Columns& out) {
  const auto rows = [s](const auto& p, const auto& q, auto& r) {
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < Count; ++j) r[i][j] = p[i][j] + s * q[i][j];
  };
  rows(a.p, b.p, out.p), rows(a.sigma, b.sigma, out.sigma), rows(a.v, b.v, out.v), rows(a.omega, b.omega, out.omega);
}

}  // namespace

BackupFlow::BackupFlow(const BackupPolicy& policy, double horizon_s, int nodes, int steps, bool drift)
    : policy_(policy), horizon_(horizon_s), nodes_(nodes), steps_(steps), has_drift_(drift) {
  if (!(horizon_s > 0 && std::isfinite(horizon_s)))
    throw std::invalid_argument("the horizon of the backup flow must be positive");
  if (nodes < 1 || nodes > 1000 || steps < 1 || steps > 100)
    throw std::invalid_argument("the backup flow needs 1 to 1000 nodes of 1 to 100 steps");
  step_ = horizon_s / nodes / steps;
  node_.resize(static_cast<std::size_t>(nodes) + 1);
}

template <int Count>
void BackupFlow::times(const ClosedLoopJacobian& d, const Columns& w, Columns& out) {
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < Count; ++j) out.p[i][j] = w.v[i][j];
  product<Count, false>(d.sigma_sigma, w.sigma, out.sigma);
  product<Count, true>(d.sigma_omega, w.omega, out.sigma);
  product<Count, false>(d.v_sigma, w.sigma, out.v);
  product<Count, true>(d.v_v, w.v, out.v);
  product<Count, false>(d.omega_sigma, w.sigma, out.omega);
  product<Count, true>(d.omega_v, w.v, out.omega);
  product<Count, true>(d.omega_omega, w.omega, out.omega);
}

template <int Count>
void BackupFlow::integrate(const Manoeuvre& manoeuvre) {
  const double h = step_;
  ClosedLoopJacobian d;
  Columns k, sum, w;
  for (int node = 0, tick = 0; node < nodes_; ++node) {
    Node next = node_[static_cast<std::size_t>(node)];
    for (int step = 0; step < steps_; ++step, ++tick) {
      const Vec3 hold = manoeuvre.at(tick);
      const State x = next.x;
      const Columns start = next.w;
      const State k1 = closed_loop(policy_, x, hold, d);
      times<Count>(d, start, sum);
      add_scaled<Count>(start, h / 2, sum, w);
      const State k2 = closed_loop(policy_, x + h / 2 * k1, hold, d);
      times<Count>(d, w, k);
      add_scaled<Count>(start, h / 2, k, w), add_scaled<Count>(sum, 2, k, sum);
      const State k3 = closed_loop(policy_, x + h / 2 * k2, hold, d);
      times<Count>(d, w, k);
      add_scaled<Count>(start, h, k, w), add_scaled<Count>(sum, 2, k, sum);
      const State k4 = closed_loop(policy_, x + h * k3, hold, d);
      times<Count>(d, w, k);
      add_scaled<Count>(sum, 1, k, sum);
      next.x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
      add_scaled<Count>(start, h / 6, sum, next.w);
    }
    node_[static_cast<std::size_t>(node) + 1] = next;
  }
}

void BackupFlow::run(const State& x, const Manoeuvre& manoeuvre) {
  if (manoeuvre.ticks > 0 && !has_drift_)
    throw std::logic_error("a manoeuvre that holds a velocity needs the column of the drift");
  const Quadrotor& vehicle = policy_.vehicle();
  const Vec3 b = thrust_axis(x.sigma), inertia = vehicle.inertia(), rate = attitude_rate(x.sigma, x.omega);
  const Vec3 gyration = divide(cross(x.omega, multiply(inertia, x.omega)), inertia);
  input_ = policy_(x, manoeuvre.at(0));
  Node& first = node_[0];
  first = Node{x, {}};
  for (std::size_t i = 0; i < 3; ++i) {
    const int axis = static_cast<int>(i);
    first.w.v[i][0] = b[axis] / vehicle.mass();
    first.w.omega[i][i + 1] = 1 / inertia[axis];
    first.w.p[i][4] = x.v[axis], first.w.sigma[i][4] = rate[axis];
    first.w.v[i][4] = -vehicle.gravity() * e3[axis], first.w.omega[i][4] = -gyration[axis];
  }
  if (has_drift_) return integrate<5>(manoeuvre);
  integrate<4>(manoeuvre);
  const Vec4 u{input_.thrust, input_.torque.x, input_.torque.y, input_.torque.z};
  for (int k = 0; k <= nodes_; ++k) {
    Node& node = node_[static_cast<std::size_t>(k)];
    const State flow = closed_loop(policy_, node.x);
    const auto fill = [&u](Rows3& rows, Vec3 value) {
      for (std::size_t i = 0; i < 3; ++i)
        rows[i][4] = value[static_cast<int>(i)] -
                     (rows[i][0] * u[0] + rows[i][1] * u[1] + rows[i][2] * u[2] + rows[i][3] * u[3]);
    };
    fill(node.w.p, flow.p), fill(node.w.sigma, flow.sigma), fill(node.w.v, flow.v), fill(node.w.omega, flow.omega);
  }
}

std::array<Vec4, 12> BackupFlow::sensitivity(int k) const {
  const Columns& w = node_[static_cast<std::size_t>(k)].w;
  std::array<Vec4, 12> result{};
  std::size_t at = 0;
  for (const Rows3* rows : {&w.p, &w.sigma, &w.v, &w.omega})
    for (std::size_t i = 0; i < 3; ++i, ++at) std::copy_n((*rows)[i].begin(), 4, result[at].begin());
  return result;
}

std::array<double, 12> BackupFlow::drift(int k) const {
  const Columns& w = node_[static_cast<std::size_t>(k)].w;
  std::array<double, 12> result{};
  std::size_t at = 0;
  for (const Rows3* rows : {&w.p, &w.sigma, &w.v, &w.omega})
    for (std::size_t i = 0; i < 3; ++i) result[at++] = (*rows)[i][4];
  return result;
}

WrenchRow BackupFlow::row(Vec3 by_p, Vec3 by_v, int k, double level) const {
  const Columns& w = node_[static_cast<std::size_t>(k)].w;
  std::array<double, kColumns> sum{};
  for (std::size_t j = 0; j < kColumns; ++j)
    sum[j] = by_p.x * w.p[0][j] + by_p.y * w.p[1][j] + by_p.z * w.p[2][j] + by_v.x * w.v[0][j] + by_v.y * w.v[1][j] +
             by_v.z * w.v[2][j];
  return {{sum[0], sum[1], sum[2], sum[3]}, -sum[4] - level};
}

WrenchRow BackupFlow::running_row(const Cone& cone, int k, double alpha) const {
  return row(cone.grad_p(), cone.w, k, alpha * cone.h);
}

WrenchRow BackupFlow::clear_row(const Cone& cone, int k, double alpha) const {
  return row(cone.gamma_grad_p(), {}, k, alpha * cone.gamma);
}

}  // namespace alula::flight
