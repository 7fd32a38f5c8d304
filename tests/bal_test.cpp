// SPDX-License-Identifier: Apache-2.0
#include "io/bal.hpp"

#include <bzlib.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <cmath>
#include <cstdlib>
#include <limits>

#include "io/bal_parallel.hpp"
#include "io/formats.hpp"
#include "temporary_folder.hpp"

namespace clba {
namespace {

using test::content_of;
using test::TemporaryFolder;
using test::throws;

constexpr double epsilon = std::numeric_limits<double>::epsilon();

// 2 images, 1 point, 2 observations.
const char* const small_text =
    "2 1 2\n"
    "0 0 1.5 -2.25\n"
    "1 0 3e2 4\n"
    "0.1\n0.2\n-0.3\n1\n2\n3\n500\n-0.1\n0.01\n"
    "0\n0\n0\n-1\n-2\n-3\n600\n0.2\n0.02\n"
    "7\n8\n-9\n";

std::string gzipped(const std::string& content) {
    z_stream stream{};
    EXPECT_EQ(deflateInit2(&stream, 6, Z_DEFLATED, 31, 8, Z_DEFAULT_STRATEGY), Z_OK);
    std::string output(deflateBound(&stream, content.size()) + 64, '\0');
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(content.data()));
    stream.avail_in = static_cast<uInt>(content.size());
    stream.next_out = reinterpret_cast<Bytef*>(output.data());
    stream.avail_out = static_cast<uInt>(output.size());
    EXPECT_EQ(deflate(&stream, Z_FINISH), Z_STREAM_END);
    output.resize(output.size() - stream.avail_out);
    deflateEnd(&stream);
    return output;
}

std::string bzipped(const std::string& content) {
    std::string output(content.size() + content.size() / 100 + 600, '\0');
    auto size = static_cast<unsigned>(output.size());
    EXPECT_EQ(BZ2_bzBuffToBuffCompress(output.data(), &size, const_cast<char*>(content.data()),
                                       static_cast<unsigned>(content.size()), 9, 0, 0),
              BZ_OK);
    output.resize(size);
    return output;
}

// Enough rows, with digits that do not repeat, for many blocks of every reader and writer.
Problem large_problem() {
    Problem problem;
    uint64_t state = 1;
    const auto random = [&state] {  // Knuth's linear congruential generator, in (-1, 1)
        state = state * 6364136223846793005u + 1442695040888963407u;
        return static_cast<double>(static_cast<int64_t>(state)) * 0x1p-63;
    };
    for (int i = 0; i < 50; ++i) {
        Image image;
        image.camera = i;
        const double x = random(), y = random(), z = random();
        image.pose.rotation = quaternion_from_rotation_vector({3 * x, y, z});
        for (double& t : image.pose.translation) t = 10 * random();
        problem.images.push_back(image);
        Camera camera;
        for (int k = 0; k < 3; ++k) camera.params[k] = random();
        problem.cameras.push_back(camera);
    }
    for (int p = 0; p < 20000; ++p) {
        const double x = random(), y = random(), z = random();
        problem.points.push_back({x * 1e-7, y * 1e5, z});
        for (int k = 0; k < 3; ++k) {
            const double u = random(), v = random();
            problem.observations.push_back({(p * 7 + k) % 50, p, 1000 * u, v});
        }
    }
    return problem;
}

void expect_same(const Problem& a, const Problem& b) {
    ASSERT_EQ(a.num_images(), b.num_images());
    ASSERT_EQ(a.num_points(), b.num_points());
    ASSERT_EQ(a.num_observations(), b.num_observations());
    EXPECT_EQ(a.points, b.points);
    for (size_t i = 0; i < a.observations.size(); ++i) {
        const Observation &o = a.observations[i], &q = b.observations[i];
        ASSERT_TRUE(o.image == q.image && o.point == q.point && o.x == q.x && o.y == q.y) << i;
    }
    for (int32_t i = 0; i < a.num_images(); ++i) {
        const Image &image = a.images[i], &other = b.images[i];
        EXPECT_EQ(a.cameras[image.camera].params, b.cameras[other.camera].params) << i;
        EXPECT_EQ(image.pose.translation, other.pose.translation) << i;
        const auto matrix = rotation_matrix(image.pose.rotation);
        const auto other_matrix = rotation_matrix(other.pose.rotation);
        for (int k = 0; k < 9; ++k) EXPECT_NEAR(matrix[k], other_matrix[k], 20 * epsilon) << i;
    }
}

class BalTest : public testing::Test {
protected:
    testing::AssertionResult rejects(const std::string& content,
                                     std::initializer_list<std::string> parts) {
        const std::string path = folder.file("problem.txt", content);
        const auto result = throws([&] { read_bal(path); }, Status::format, parts);
        return result ? throws([&] { read_bal(path); }, Status::format, {path}) : result;
    }
    static std::string replaced(const std::string& from, const std::string& to) {
        std::string content = small_text;
        const size_t position = content.find(from);
        EXPECT_NE(position, std::string::npos) << from;
        return content.replace(position, from.size(), to);
    }

    TemporaryFolder folder;
};

TEST_F(BalTest, ReadsEveryNumber) {
    const Problem problem = read_bal(folder.file("problem.txt", small_text));
    problem.validate();
    ASSERT_EQ(problem.num_images(), 2);
    ASSERT_EQ(problem.num_cameras(), 2);
    ASSERT_EQ(problem.num_points(), 1);
    ASSERT_EQ(problem.num_observations(), 2);
    EXPECT_EQ(problem.observations[0].image, 0);
    EXPECT_EQ(problem.observations[0].x, 1.5);
    EXPECT_EQ(problem.observations[0].y, -2.25);
    EXPECT_EQ(problem.observations[1].image, 1);
    EXPECT_EQ(problem.observations[1].point, 0);
    EXPECT_EQ(problem.observations[1].x, 300);
    EXPECT_EQ(problem.images[0].pose.rotation, quaternion_from_rotation_vector({0.1, 0.2, -0.3}));
    EXPECT_EQ(problem.images[0].pose.translation, (std::array<double, 3>{1, 2, 3}));
    EXPECT_EQ(problem.images[1].camera, 1);
    EXPECT_EQ(problem.images[1].pose.rotation, (std::array<double, 4>{1, 0, 0, 0}));
    EXPECT_EQ(problem.cameras[0].model, camera_snavely);
    EXPECT_EQ(problem.cameras[1].params[0], 600);
    EXPECT_EQ(problem.cameras[1].params[1], 0.2);
    EXPECT_EQ(problem.cameras[1].params[2], 0.02);
    EXPECT_EQ(problem.points[0], (Point{7, 8, -9}));
}

TEST_F(BalTest, AnyWhiteSpaceSeparates) {
    const Problem expected = read_bal(folder.file("problem.txt", small_text));
    std::string content = small_text;
    for (char& c : content)
        if (c == '\n') c = ' ';
    expect_same(read_bal(folder.file("one_line.txt", "\n " + content)), expected);
    std::string windows;
    for (char c : std::string(small_text))
        windows += c == '\n' ? "\r\n" : c == ' ' ? "\t \t" : std::string(1, c);
    expect_same(read_bal(folder.file("windows.txt", windows)), expected);
    content.pop_back();
    expect_same(read_bal(folder.file("no_line_end.txt", content)), expected);
}

TEST_F(BalTest, ReadsProblemsWithoutObservations) {
    const Problem nothing = read_bal(folder.file("nothing.txt", "0 0 0\n"));
    EXPECT_EQ(nothing.num_images() + nothing.num_points() + nothing.num_observations(), 0);
    const Problem problem = read_bal(folder.file("point.txt", "0 1 0\n1 2 3\n"));
    EXPECT_EQ(problem.points.at(0), (Point{1, 2, 3}));
}

// A quaternion rounds a rotation vector, which must not drift from file to file.
TEST_F(BalTest, FilesThatAreWrittenBackAreEqual) {
    write_bal(large_problem(), folder.path("first.txt"));
    ReadFile read = read_reconstruction(folder.path("first.txt"), Format::automatic, {});
    const FileFormat& bal = *find_format(Format::bal);
    bal.write(read.reconstruction, folder.path("again.txt"));
    EXPECT_EQ(content_of(folder.path("again.txt")), content_of(folder.path("first.txt")));
    for (const Format other : {Format::bundler, Format::openmvg, Format::opensfm})
        EXPECT_TRUE(losses(read.reconstruction, *find_format(other)).empty());
    auto& rotation = read.reconstruction.problem.images[1].pose.rotation;
    rotation = {1, 0, 0, 0};
    bal.write(read.reconstruction, folder.path("moved.txt"));
    EXPECT_EQ(read_bal(folder.path("moved.txt")).images[1].pose.rotation, rotation);
}

TEST_F(BalTest, RoundTripsPlainAndCompressed) {
    const Problem problem = large_problem();
    for (const char* name : {"problem.txt", "problem.txt.gz", "problem.txt.bz2"}) {
        SCOPED_TRACE(name);
        write_bal(problem, folder.path(name));
        expect_same(read_bal(folder.path(name)), problem);
    }
    EXPECT_EQ(content_of(folder.path("problem.txt.gz")).substr(0, 2), "\x1f\x8b");
    EXPECT_EQ(content_of(folder.path("problem.txt.bz2")).substr(0, 3), "BZh");
    EXPECT_EQ(folder.num_files(), 3u);
}

TEST_F(BalTest, ReadsTheSameInPiecesOfAnySize) {
    const Problem problem = read_bal(folder.file("problem.txt", small_text));
    write_bal(large_problem(), folder.path("large.txt"));
    const Problem large = read_bal(folder.path("large.txt"));
    const auto expect_equal = [&](const char* name, const Problem& expected, size_t window_bytes) {
        BalNumbers numbers;
        ASSERT_TRUE(read_bal_in_parallel(folder.path(name), window_bytes, numbers));
        Problem read = expected;
        read.observations = numbers.observations;
        read.points = numbers.points;
        expect_same(read, expected);
        ASSERT_EQ(numbers.images.size(), expected.images.size());
        for (size_t i = 0; i < numbers.images.size(); ++i)
            for (size_t k = 0; k < 3; ++k) {
                EXPECT_EQ(numbers.images[i][3 + k], expected.images[i].pose.translation[k]);
                EXPECT_EQ(numbers.images[i][6 + k], expected.cameras[i].params[k]);
            }
    };
    for (size_t window_bytes = 16; window_bytes < 100; ++window_bytes)
        expect_equal("problem.txt", problem, window_bytes);
    for (size_t window_bytes : {5000, 65537, 1 << 20, 1 << 24})
        expect_equal("large.txt", large, window_bytes);
}

TEST_F(BalTest, LeavesWhatIsWrongToTheSerialReader) {
    const auto is_read = [&](const std::string& content) {
        BalNumbers numbers;
        return read_bal_in_parallel(folder.file("problem.txt", content), 32, numbers);
    };
    EXPECT_TRUE(is_read(small_text));
    for (const auto& [from, to] : std::initializer_list<std::pair<const char*, const char*>>{
             {"1.5", "x"},
             {"1.5", "inf"},
             {"1 0 3e2", "2 0 3e2"},
             {"1 0 3e2", "1 1 3e2"},
             {"1 0 3e2", "1.0 0 3e2"},
             {"2 1 2", "2 1 -2"},
             {"2 1 2", "2 1 9999999999"},
             {"2 1 2", "2 1 1"},
             {"2 1 2", "2 1 3"},
             {"-9", "-9 1"},
             {"-9", ""},
             {"-9", "-999999999999999999999999999999999999999999"}})
        EXPECT_FALSE(is_read(replaced(from, to))) << from << " replaced by " << to;
    EXPECT_FALSE(is_read(gzipped(small_text)));
    EXPECT_FALSE(is_read(""));
    EXPECT_TRUE(throws(
        [&] {
            write_bal(large_problem(), folder.path("large.txt"));
            read_bal(folder.file("more.txt", content_of(folder.path("large.txt")) + "7\n"));
        },
        Status::format, {"'7' follows the last point"}));
}

TEST_F(BalTest, TellsCompressionByContent) {
    const Problem expected = read_bal(folder.file("problem.txt", small_text));
    expect_same(read_bal(folder.file("gzip.txt", gzipped(small_text))), expected);
    expect_same(read_bal(folder.file("bzip.gz", bzipped(small_text))), expected);
    expect_same(read_bal(folder.file("plain.bz2", small_text)), expected);
}

TEST_F(BalTest, ReadsSeveralMembers) {
    const Problem expected = read_bal(folder.file("problem.txt", small_text));
    const std::string content = small_text;
    for (size_t cut : {size_t{0}, size_t{1}, size_t{9}, content.size() - 1}) {
        SCOPED_TRACE(cut);
        const std::string left = content.substr(0, cut), right = content.substr(cut);
        expect_same(read_bal(folder.file("a.gz", gzipped(left) + gzipped(right))), expected);
        expect_same(read_bal(folder.file("a.bz2", bzipped(left) + bzipped(right))), expected);
    }
}

TEST_F(BalTest, RejectsCompressedDataThatEndEarly) {
    write_bal(large_problem(), folder.path("whole.txt"));
    const std::string content = content_of(folder.path("whole.txt"));
    for (const std::string& whole : {gzipped(content), bzipped(content)}) {
        for (size_t size : {size_t{11}, whole.size() / 2, whole.size() - 1})
            EXPECT_TRUE(rejects(whole.substr(0, size), {"data end early", "truncated"})) << size;
    }
    const std::string small = gzipped(small_text);
    EXPECT_TRUE(rejects(small + small.substr(0, 12), {"gzip data end early"}));
    const std::string small_bzip = bzipped(small_text);
    EXPECT_TRUE(rejects(small_bzip + small_bzip.substr(0, 12), {"bzip2 data end early"}));
}

TEST_F(BalTest, RejectsDamagedCompressedData) {
    std::string gzip = gzipped(small_text), bzip = bzipped(small_text);
    gzip[gzip.size() - 6] ^= 1;  // the checksum
    bzip[bzip.size() / 2] ^= 16;
    EXPECT_TRUE(rejects(gzip, {"gzip data are damaged"}));
    EXPECT_TRUE(rejects(bzip, {"bzip2 data are damaged"}));
    EXPECT_TRUE(rejects(gzipped(small_text) + "more", {"gzip data are damaged"}));
    EXPECT_TRUE(rejects(bzipped(small_text) + "more", {"bzip2 data are damaged"}));
}

TEST_F(BalTest, RejectsFilesThatCannotBeRead) {
    EXPECT_TRUE(throws([&] { read_bal(folder.path("absent.txt")); }, Status::file,
                       {"cannot open", "absent.txt", "No such file"}));
    EXPECT_TRUE(throws([&] { read_bal(folder.path("")); }, Status::file,
                       {"cannot read", "Is a directory"}));
}

TEST_F(BalTest, RejectsEmptyFiles) {
    EXPECT_TRUE(rejects("", {"is empty", "num_images num_points num_observations"}));
    EXPECT_TRUE(rejects(" \n\n", {"is empty"}));
    EXPECT_TRUE(rejects(gzipped(""), {"is empty"}));
    EXPECT_TRUE(rejects(bzipped(""), {"is empty"}));
}

TEST_F(BalTest, SaysWhereATruncatedFileEnds) {
    EXPECT_TRUE(rejects("2 1", {"ends at line 1 where num_observations was expected"}));
    EXPECT_TRUE(rejects("2 1 2\n0 0 1.5 -2.25\n1 0\n",
                        {"ends at line 3 where the x of observation 1 of 2 was expected"}));
    EXPECT_TRUE(rejects("2 1 2\n0 0 1.5 -2.25\n",
                        {"ends at line 2 where the image index of observation 1 of 2"}));
    EXPECT_TRUE(rejects(replaced("600\n0.2\n0.02\n7\n8\n-9\n", "600\n"),
                        {"ends at line 19 where the k1 of image 1 of 2 was expected"}));
    EXPECT_TRUE(rejects(replaced("-9\n", ""),
                        {"ends at line 23 where the z of point 0 of 1 was expected"}));
}

TEST_F(BalTest, RejectsWhatIsNoNumber) {
    EXPECT_TRUE(rejects("<!DOCTYPE html>", {":1: num_images is '<!DOCTYPE', but", "integer"}));
    EXPECT_TRUE(rejects(replaced("-2.25", "abc"),
                        {":2: the y of observation 0 of 2 is 'abc', but it must be a number"}));
    EXPECT_TRUE(rejects(replaced("-2.25", "1.5x"), {"'1.5x', but it must be a number"}));
    EXPECT_TRUE(rejects(replaced("500", "\x01\xff"), {"focal length f of image 0 of 2 is '?\?'"}));
    EXPECT_TRUE(rejects(replaced("0 0 1.5", "0 0.5 1.5"),
                        {":2: the point index of observation 0 of 2 is '0.5', but", "integer"}));
    EXPECT_TRUE(rejects(replaced("7\n", std::string(100, 'z') + "\n"), {":22: ", "zzz...'"}));
    EXPECT_TRUE(rejects(std::string(3 << 20, '7'), {":1: a word of more than"}));
    EXPECT_TRUE(rejects(std::string(100, '\0'), {":1: num_images is '???"}));
}

TEST_F(BalTest, RejectsWhatIsNotFinite) {
    for (const char* value : {"nan", "NaN", "inf", "-inf", "1e999"})
        EXPECT_TRUE(rejects(replaced("8\n-9", std::string(value) + "\n-9"),
                            {text(":23: the y of point 0 of 1 is '", value, "'"), "finite"}));
    EXPECT_TRUE(rejects(replaced("0.1\n0.2\n", "1e200\n0.2\n"),
                        {":12: the rotation vector of image 0", "1e+200", "finite"}));
    const Problem problem = read_bal(folder.file("tiny.txt", replaced("8\n-9", "1e-999\n-9")));
    EXPECT_EQ(problem.points[0][1], 0);
}

TEST_F(BalTest, RejectsWrongCounts) {
    EXPECT_TRUE(rejects("-3 1 1\n", {":1: num_images = -3, but it must be from 0 to 2147483647"}));
    EXPECT_TRUE(rejects("1\n2147483648 1", {":2: num_points = 2147483648, but", "2147483647"}));
    EXPECT_TRUE(rejects("1 1 99999999999999999999",
                        {"num_observations = 99999999999999999999, but", "9223372036854775807"}));
    EXPECT_TRUE(rejects("1 1 -1", {"num_observations = -1, but it must be from 0"}));
}

// Room for the counts of such a header would be more than any machine has.
TEST_F(BalTest, DoesNotAllocateByTheHeader) {
    EXPECT_TRUE(rejects("2147483647 2147483647 9223372036854775807\n0 0 1 2\n",
                        {"ends at line 2 where the image index of observation 1 of 922"}));
    EXPECT_TRUE(rejects("2147483647 2147483647 0\n", {"the rotation vector's x of image 0"}));
    EXPECT_TRUE(rejects("0 2147483647 0\n", {"the x of point 0 of 2147483647"}));
}

TEST_F(BalTest, RejectsIndicesOutOfRange) {
    EXPECT_TRUE(rejects(replaced("\n1 0", "\n900 0"),
                        {":3: observation 1 has the image index 900, but num_images = 2"}));
    EXPECT_TRUE(rejects(replaced("\n1 0", "\n-1 0"), {"image index -1, but num_images = 2"}));
    EXPECT_TRUE(rejects(replaced("\n1 0", "\n1 1"),
                        {":3: observation 1 has the point index 1, but num_points = 1"}));
    EXPECT_TRUE(rejects(replaced("\n1 0", "\n4294967296 0"), {"image index 4294967296, but"}));
}

TEST_F(BalTest, RejectsWhatFollowsTheLastPoint) {
    EXPECT_TRUE(rejects(std::string(small_text) + "\n17\n", {":26: '17' follows the last point"}));
    EXPECT_TRUE(rejects("0 0 0 end", {":1: 'end' follows the last observation"}));
}

TEST_F(BalTest, WritesSharedCamerasForEachImage) {
    Problem problem = read_bal(folder.file("problem.txt", small_text));
    problem.images[0].camera = 1;
    write_bal(problem, folder.path("shared.txt"));
    const Problem read = read_bal(folder.path("shared.txt"));
    EXPECT_EQ(read.num_cameras(), 2);
    EXPECT_EQ(read.cameras[0].params[0], 600);
    EXPECT_EQ(read.cameras[1].params[0], 600);
}

TEST_F(BalTest, WritesOnlySnavelyCameras) {
    Problem problem = read_bal(folder.file("problem.txt", small_text));
    problem.cameras[1].model = camera_opencv;
    EXPECT_TRUE(throws([&] { write_bal(problem, folder.path("problem.txt")); },
                       Status::invalid_argument, {"cameras[1]", "opencv", "snavely"}));
    EXPECT_EQ(content_of(folder.path("problem.txt")), small_text);
}

TEST_F(BalTest, FailedWritesLeaveNothing) {
    const Problem problem = read_bal(folder.file("problem.txt", small_text));
    EXPECT_TRUE(throws([&] { write_bal(problem, folder.path("absent/out.txt")); }, Status::file,
                       {"cannot write", "absent/out.txt"}));
    std::filesystem::create_directory(folder.path("a_folder"));
    EXPECT_TRUE(throws([&] { write_bal(problem, folder.path("a_folder")); }, Status::file,
                       {"cannot write", "a_folder"}));
    EXPECT_EQ(folder.num_files(), 2u);
}

TEST_F(BalTest, RoundTripsRealProblems) {
    const char* data = std::getenv("CLBA_TEST_DATA");
    const std::string path = std::string(data ? data : "") + "/bal/problem-16-22106-pre.txt.bz2";
    if (!data || !std::filesystem::exists(path)) GTEST_SKIP() << "no " << path;
    const Problem problem = read_bal(path);
    EXPECT_EQ(problem.num_images(), 16);
    EXPECT_EQ(problem.num_points(), 22106);
    EXPECT_EQ(problem.num_observations(), 83718);
    problem.validate();
    write_bal(problem, folder.path("problem.txt"));
    expect_same(read_bal(folder.path("problem.txt")), problem);
}

}  // namespace
}  // namespace clba
