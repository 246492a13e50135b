// The QP solver: no allocation, extreme numbers, a verdict for every input, backends.
#include "alula/qp/qp.hpp"

#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <stdexcept>
#include <utility>
#include <vector>

#include "allocations.hpp"
#include "check.hpp"

using namespace alula;

namespace {

struct Data {
  std::size_t n;
  std::vector<double> hessian, gradient, rows, bounds;
  QpProblem view() const { return {n, hessian, gradient, rows, bounds}; }
};

Data random_problem(std::mt19937_64& random, std::size_t n, std::size_t m, double shift) {
  std::normal_distribution<double> normal;
  Data data{n, std::vector<double>(n * n), std::vector<double>(n), std::vector<double>(m * n),
            std::vector<double>(m)};
  std::vector<double> basis(n * n);
  for (double& v : basis) v = normal(random);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      for (std::size_t k = 0; k < n; ++k) data.hessian[i * n + j] += basis[i * n + k] * basis[j * n + k];
    }
    data.hessian[i * n + i] += 0.1;
  }
  for (double& v : data.gradient) v = 3 * normal(random);
  for (double& v : data.rows) v = normal(random);
  for (double& v : data.bounds) v = normal(random) - shift;
  return data;
}

void test_no_allocation() {
  std::mt19937_64 random(1);
  std::vector<Data> problems;
  for (std::size_t n = 1; n <= kQpMaxVariables; ++n) {
    for (const std::size_t m : {std::size_t{0}, std::size_t{3}, std::size_t{70}, std::size_t{3000}}) {
      for (const double shift : {0.0, 3.0}) problems.push_back(random_problem(random, n, m, shift));
    }
  }
  // Two programs outside the range of double precision, which only the run in extended precision decides.
  for (const double size : {1e-300, 1e300}) {
    problems.push_back({2, {1, 0, 0, 1}, {1, 0}, {size, 0, 0, 1}, {size, -1}});
  }
  QpSolver solver(3000);
  const std::size_t before = allocations;
  std::size_t optimal = 0, infeasible = 0;
  for (const Data& data : problems) {
    const QpResult cold = solver.solve(data.view());
    const QpResult warm = solver.solve(data.view(), {cold.active.data(), cold.active_count});
    CHECK(cold.status != QpStatus::failed);
    CHECK(warm.status == cold.status);
    optimal += cold.status == QpStatus::optimal;
    infeasible += cold.status == QpStatus::infeasible;
  }
  CHECK(allocations == before);
  CHECK(optimal > 10);
  CHECK(infeasible > 10);

  QpSolver unprepared;
  unprepared.solve(problems.back().view());
  for (const Data& data : problems) unprepared.solve(data.view());
  const std::size_t grown = allocations;
  for (const Data& data : problems) unprepared.solve(data.view());
  CHECK(allocations == grown);
}

// Random bits: a verdict without a trap, finite when optimal.
void test_any_numbers() {
  std::mt19937_64 random(2);
  const double odd[] = {0.0,         -0.0,   1.0,   -1.0,  1e-320,
                        1e-308,      1e-160, 1e160, 1e300, -1e300,
                        1e308,       -1e308, 1e-8,  1e8,   std::numeric_limits<double>::infinity(),
                        std::nan("")};
  QpSolver solver;
  int finite = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    const std::size_t n = 1 + random() % kQpMaxVariables, m = random() % 12;
    Data data = random_problem(random, n, m, 1);
    const std::size_t kinds = trial % 4 == 0 ? 16 : 14;
    for (auto* part : {&data.hessian, &data.gradient, &data.rows, &data.bounds}) {
      for (double& v : *part) {
        if (random() % 8 == 0 && (part != &data.hessian || random() % 8 == 0)) v = odd[random() % kinds];
      }
    }
    std::vector<std::uint32_t> warm(random() % 5);
    for (auto& row : warm) row = static_cast<std::uint32_t>(random() % (m + 2));
    const QpResult result = solver.solve(data.view(), warm);
    CHECK(result.active_count <= n + 1);
    for (std::size_t k = 0; k < result.active_count; ++k) {
      CHECK(result.active[k] < m && result.multiplier[k] > 0);
      CHECK(k == 0 || result.active[k - 1] < result.active[k]);
    }
    if (result.status == QpStatus::failed) {
      CHECK(std::isinf(result.violation) && result.active_count == 0);
      continue;
    }
    ++finite;
    for (const double v : result.x) CHECK(std::isfinite(v));
    for (const auto* part : {&data.hessian, &data.gradient, &data.rows, &data.bounds}) {
      for (const double v : *part) CHECK(std::isfinite(v));
    }
    CHECK(result.violation >= 0);
  }
  CHECK(finite > 2000);
}

void test_sizes() {
  QpSolver solver;
  const std::vector<double> one(200, 1.0);
  const auto refused = [&](std::size_t n, std::size_t hessian, std::size_t gradient, std::size_t rows,
                           std::size_t bounds) {
    try {
      solver.solve({n, {one.data(), hessian}, {one.data(), gradient}, {one.data(), rows}, {one.data(), bounds}});
    } catch (const std::invalid_argument&) {
      return true;
    }
    return false;
  };
  CHECK(refused(0, 0, 0, 0, 0));
  for (const std::size_t n : {kQpMaxVariables, kQpMaxVariables + 1}) {
    CHECK(refused(n, n * n, n, 0, 0) == (n > kQpMaxVariables));
  }
  CHECK(refused(2, 3, 2, 2, 1));
  CHECK(refused(2, 4, 1, 2, 1));
  CHECK(refused(2, 4, 2, 3, 1));
  CHECK(!refused(1, 1, 1, 4, 4));
}

void test_backend() {
  const Data data{1, {1}, {0}, {2}, {2}};
  int calls = 0;
  QpSolver solver = QpSolver::with_backend([&calls](const QpProblem& problem) {
    ++calls;
    QpResult result;
    result.status = QpStatus::optimal;
    result.x[0] = 0.5 * problem.bounds[0] / problem.rows[0];
    return result;
  });
  QpSolver copy = solver;
  CHECK(solver.solve(data.view()).violation == 0.5);
  CHECK(copy.solve(data.view()).x[0] == 0.5);
  CHECK(calls == 2);
  CHECK(QpSolver().solve(data.view()).x[0] == 1);
}

}  // namespace

int main() {
  test_no_allocation();
  test_any_numbers();
  test_sizes();
  test_backend();
  return alula_failures == 0 ? 0 : 1;
}
