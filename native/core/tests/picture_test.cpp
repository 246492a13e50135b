// Pictures: a Gaussian against its formula, order, depth of triangles, lines behind matter, threads, bad values.
#include "alula/rendering/picture.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>

#include "check.hpp"

using namespace alula;
using rendering::Camera;
using rendering::Picture;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct World {
  std::vector<float> mean, covariance, opacity, triangle_opacity, style;
  std::vector<std::uint8_t> color, triangle_color, line_color;
  std::vector<double> corner, end;
  std::vector<std::int32_t> line;

  void add_ball(std::array<float, 3> at, float sigma, std::array<std::uint8_t, 3> rgb, float alpha) {
    mean.insert(mean.end(), at.begin(), at.end());
    for (int i = 0; i < 9; ++i) covariance.push_back(i % 4 == 0 ? sigma * sigma : 0);
    color.insert(color.end(), rgb.begin(), rgb.end());
    opacity.push_back(alpha);
  }
  void add_triangle(std::array<double, 9> at, std::array<std::uint8_t, 3> rgb, float alpha) {
    corner.insert(corner.end(), at.begin(), at.end());
    triangle_color.insert(triangle_color.end(), rgb.begin(), rgb.end());
    triangle_opacity.push_back(alpha);
  }
  void add_line(std::array<double, 6> at, float width, float through, std::int32_t number) {
    end.insert(end.end(), at.begin(), at.end());
    line_color.insert(line_color.end(), {255, 0, 0});
    style.insert(style.end(), {width, 0.5f, through});
    line.push_back(number);
  }
  Picture draw(const Camera& camera, unsigned jobs = 1) const {
    Control control;
    return rendering::draw(camera, {mean, covariance, color, opacity}, {corner, triangle_color, triangle_opacity},
                           {end, line_color, style, line}, jobs, control);
  }
};

Camera camera_of(double focal, std::size_t columns, std::size_t rows, bool is_parallel = false) {
  return {geometry::identity(), {}, focal, is_parallel, 0.1, columns, rows};
}

bool is_near(double a, double b, double tolerance) { return std::abs(a - b) <= tolerance; }

// With the centre on the optical axis J is diag(f/z, f/z) without a third column, so sigma' = sigma f / z.
void test_a_ball_is_its_formula() {
  for (const bool is_parallel : {false, true}) {
    const Camera camera = camera_of(is_parallel ? 10.0 : 40.0, 64, 48, is_parallel);
    World world;
    world.add_ball({0, 0, 4}, 0.5f, {200, 100, 50}, 0.8f);
    const Picture picture = world.draw(camera);
    const double variance = 25 + rendering::kLowPass;
    for (std::size_t row = 0; row < camera.rows; ++row)
      for (std::size_t column = 0; column < camera.columns; ++column) {
        const double dx = static_cast<double>(column) + 0.5 - 32, dy = static_cast<double>(row) + 0.5 - 24;
        const double alpha = 0.8 * std::exp(-0.5 * (dx * dx + dy * dy) / variance);
        const std::size_t p = row * camera.columns + column;
        const double seen = 1 - static_cast<double>(picture.light[p]);
        // cut off below 1/255, else single precision
        CHECK(is_near(seen, alpha, 1e-5) || (seen == 0 && alpha < 1.001 / 255));
        CHECK(is_near(static_cast<double>(picture.color[3 * p]), 200 * seen, 1e-3));
      }
  }
}

// Seen from the side, J has a third column: sigma' along x is (f/z)^2 (1 + (x/z)^2) sigma^2.
void test_perspective_stretches_a_ball_beside_the_axis() {
  const Camera camera = camera_of(40, 200, 48);
  World world;
  world.add_ball({4, 0, 4}, 0.2f, {255, 255, 255}, 0.9f);
  const Picture picture = world.draw(camera);
  const double x = 100 + 40, xx = 100 * 0.04 * 2 + 0.3, yy = 100 * 0.04 + 0.3;
  for (const double dx : {0.5, 2.5, 5.5})
    for (const double dy : {0.5, 3.5}) {
      const std::size_t p = static_cast<std::size_t>(24 + dy) * 200 + static_cast<std::size_t>(x + dx);
      const double alpha = 0.9 * std::exp(-0.5 * (dx * dx / xx + dy * dy / yy));
      CHECK(is_near(1 - static_cast<double>(picture.light[p]), alpha, 1e-4));
    }
}

// Rows are in no order: the near ball is in front of the triangle, which is in front of the far one.
void test_near_things_hide_far_ones() {
  const Camera camera = camera_of(30, 33, 33);
  World world;
  world.add_ball({0, 0, 9}, 30, {0, 0, 255}, 1);
  world.add_ball({0, 0, 3}, 10, {255, 0, 0}, 0.5f);
  world.add_triangle({-90, -90, 6, 90, -90, 6, 0, 200, 6}, {0, 255, 0}, 0.5f);
  const Picture picture = world.draw(camera);
  const std::size_t p = 16 * 33 + 16;
  CHECK(is_near(static_cast<double>(picture.color[3 * p]), 0.5 * 255, 0.1));
  CHECK(is_near(static_cast<double>(picture.color[3 * p + 1]), 0.25 * 255, 0.1));
  CHECK(is_near(static_cast<double>(picture.color[3 * p + 2]), 0.25 * 0.99 * 255, 0.1));
  CHECK(is_near(static_cast<double>(picture.light[p]), 0.25 * 0.01, 1e-4));
  CHECK(picture.depth[p] == 3);  // its opacity is just one half
}

// The plane z = 5 + x / 2, cut by the near plane, and its edge at x = 0.
void test_depth_of_a_triangle_is_that_of_its_plane() {
  for (const bool is_parallel : {false, true}) {
    const Camera camera = camera_of(20, 64, 64, is_parallel);
    World world;
    world.add_triangle({0, -1e3, 5, 0, 1e3, 5, -1e3, 0, -495}, {10, 20, 30}, 1);
    const Picture picture = world.draw(camera);
    for (std::size_t column = 0; column < 64; ++column) {
      const double u = (static_cast<double>(column) + 0.5 - 32) / 20, z = is_parallel ? 5 + u / 2 : 5 / (1 - u / 2);
      const std::size_t p = 32 * 64 + column;
      CHECK(picture.light[p] == (column < 32 ? 0 : 1));
      if (column < 32)
        CHECK(is_near(static_cast<double>(picture.depth[p]), z, 1e-5));
      else
        CHECK(std::isinf(picture.depth[p]));
    }
  }
}

void test_two_triangles_leave_no_seam() {
  const Camera camera = camera_of(20, 48, 48);
  World world;
  world.add_triangle({-1, -1, 4, 1, -1, 4, 1, 1.1, 4}, {255, 255, 255}, 1);
  world.add_triangle({-1, -1, 4, 1, 1.1, 4, -1, 1, 4}, {255, 255, 255}, 1);
  const Picture picture = world.draw(camera);
  for (std::size_t k = 21; k < 27; ++k) CHECK(picture.light[k * 48 + k] == 0);
}

// Segments of one line that overlap count once, those of two lines twice; behind matter `through` is left.
void test_lines() {
  const Camera camera = camera_of(40, 40, 40);
  World world;
  world.add_line({-1, 0, 5, 0.1, 0, 5}, 4, 0.25f, 7);
  world.add_line({-0.1, 0, 5, 1, 0, 5}, 4, 0.25f, 7);
  const std::size_t p = 20 * 40 + 20;
  CHECK(is_near(static_cast<double>(world.draw(camera).light[p]), 0.5, 1e-6));
  CHECK(world.draw(camera).light[p + 4 * 40] == 1);  // 4.5 px away
  world.line[1] = 8;
  // the line behind also shows through the one in front
  CHECK(is_near(static_cast<double>(world.draw(camera).light[p]), 0.25 * (1 - 0.25 * 0.5 * 0.5), 1e-6));
  world.line[1] = 7;
  world.add_triangle({-9, -9, 4, 9, -9, 4, 0, 9, 4}, {0, 0, 200}, 1);
  const Picture hidden = world.draw(camera);
  CHECK(is_near(static_cast<double>(hidden.color[3 * p]), 255 * 0.5 * 0.25, 1e-3));
  CHECK(is_near(static_cast<double>(hidden.color[3 * p + 2]), 200 * (1 - 0.5 * 0.25), 1e-3));
}

World crowd() {
  std::mt19937 random(5);
  const auto in = [&](float low, float high) { return std::uniform_real_distribution<float>(low, high)(random); };
  World world;
  for (int i = 0; i < 6000; ++i)
    world.add_ball({in(-3, 3), in(-3, 3), in(-1, 9)}, in(0.005f, 0.3f), {static_cast<std::uint8_t>(i % 251), 90, 7},
                   in(0, 1));
  for (int i = 0; i < 60; ++i) {
    const double x = in(-3, 3), z = in(-1, 9);
    world.add_triangle({x, -1, z, x + 1, 0, z + 1, x, 1, z}, {9, 200, 80}, in(0, 1));
    world.add_line({x, -1, z, -x, 1, 9 - z}, in(0.3f, 6), 0.3f, i / 3);
  }
  return world;
}

void test_threads_give_the_same_bits() {
  const World world = crowd();
  const Camera camera = camera_of(60, 101, 77);
  const Picture one = world.draw(camera, 1), many = world.draw(camera, 3);
  CHECK(one.color == many.color && one.light == many.light && one.depth == many.depth);
}

void test_bad_values_are_skipped_and_bad_cameras_refused() {
  const Camera camera = camera_of(60, 50, 40);
  World world = crowd();
  const Picture before = world.draw(camera);
  for (const float bad : {kNan, std::numeric_limits<float>::infinity()}) {
    world.add_ball({bad, 0, 3}, 1, {1, 2, 3}, 1);
    world.add_ball({0, 0, 3}, bad, {1, 2, 3}, 1);
    world.add_ball({0, 0, 3}, 1, {1, 2, 3}, bad);
    world.add_triangle({-9, -9, static_cast<double>(bad), 9, -9, 4, 0, 9, 4}, {0, 0, 200}, 1);
    world.add_triangle({0, 0, 4, 0, 0, 4, 0, 0, 4}, {0, 0, 200}, 1);
    world.add_line({0, 0, static_cast<double>(bad), 0, 0, 4}, 3, 0, 99);
    world.add_line({0, 0, 4, 1, 0, 4}, bad, 0, 99);
  }
  world.add_ball({0, 0, 3}, 1, {1, 2, 3}, 1);
  for (std::size_t k = world.covariance.size() - 9; k < world.covariance.size(); ++k) world.covariance[k] *= -1;
  const Picture after = world.draw(camera);
  CHECK(before.color == after.color && before.light == after.light && before.depth == after.depth);

  Camera bad = camera;
  const auto is_refused = [&] {
    try {
      world.draw(bad);
    } catch (const std::invalid_argument&) {
      return true;
    }
    return false;
  };
  bad.rotation[0][0] = 2;
  CHECK(is_refused());
  bad = camera, bad.rows = 0;
  CHECK(is_refused());
  bad = camera, bad.focal = std::nan("");
  CHECK(is_refused());
}

}  // namespace

int main() {
  test_a_ball_is_its_formula();
  test_perspective_stretches_a_ball_beside_the_axis();
  test_near_things_hide_far_ones();
  test_depth_of_a_triangle_is_that_of_its_plane();
  test_two_triangles_leave_no_seam();
  test_lines();
  test_threads_give_the_same_bits();
  test_bad_values_are_skipped_and_bad_cameras_refused();
  return alula_failures != 0;
}
